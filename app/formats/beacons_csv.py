"""Beacons as a table: CSV with a header line, one beacon a row.

Columns, in any order: ``beacon_id``, ``kind`` (ble or wifi), ``floor_id``, ``x``, ``y`` (metres in
the site frame) and ``keys`` (separated by blanks) are needed; instead of ``keys`` a row may have
``mac``, or ``uuid``, ``major`` and ``minor``, or all of them. ``name``, ``z``, ``ref_level_dbm``,
``ref_distance_m``, ``path_loss_exponent`` and ``shadowing_db`` may be left out, which says nothing
of them, or empty, which says that they are as of a new beacon. What traffic says of a beacon
(``last_heard_at``, ``battery_percent``, ``battery_v``, ``temperature_c``) is written, never read.
Semicolons or tabs may separate (`separated_values`). A ``name`` that a spreadsheet would take for a
formula is written with an apostrophe before it, and read without.
"""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from app.formats.separated_values import cell_text, decimal_text, separator_of, text_cell
from app.formats.transmitters import canonical_key, ibeacon_key, mac_key

NUMBERS = (
    "x",
    "y",
    "z",
    "ref_level_dbm",
    "ref_distance_m",
    "path_loss_exponent",
    "shadowing_db",
)
COLUMNS = ("beacon_id", "kind", "name", "floor_id", *NUMBERS, "keys")
HEALTH_COLUMNS = ("last_heard_at", "battery_percent", "battery_v", "temperature_c")
KEY_COLUMNS = ("mac", "uuid", "major", "minor")
OPTIONAL = frozenset({"name", *NUMBERS}) - {"x", "y"}

MAX_ROWS = 100_000


class BeaconTableError(ValueError):
    """The text is not a table of beacons at all."""


@dataclass(frozen=True, slots=True)
class BeaconRow:
    """One row: its fields as the API names them, or what is wrong with it.

    ``line`` counts from 1 with the header, as editors do. ``unsaid`` are fields of which the table
    says nothing; those in neither are as of a new beacon.
    """

    line: int
    fields: dict[str, Any]
    error: str = ""
    unsaid: frozenset[str] = frozenset()


def read_beacons_csv(text: str) -> Iterator[BeaconRow]:
    """Yield the rows of a table; a bad row is yielded with its error, the others go on.

    Raises
    ------
    BeaconTableError
        If the header lacks a needed column or names an unknown one, or there are too many rows.
    """
    text = text.removeprefix("\ufeff")
    separator = separator_of(text)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator, strict=True)
    try:
        _check_header(reader.fieldnames or ())
        for count, row in enumerate(reader):
            if count >= MAX_ROWS:
                msg = f"more than {MAX_ROWS} rows"
                raise BeaconTableError(msg)
            yield _row(reader.line_num, row, separator)
    except csv.Error as error:
        msg = f"line {reader.line_num}: {error}"
        raise BeaconTableError(msg) from error


def write_beacons_csv(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the table of beacons given as fields of the API, as `read_beacons_csv` takes it."""
    out = io.StringIO()
    columns = (*COLUMNS, *HEALTH_COLUMNS)
    writer = csv.DictWriter(out, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        name = text_cell(row.get("name") or "")
        written = {**row, **_health(row), "name": name, "keys": " ".join(row["keys"])}
        writer.writerow(written)
    return out.getvalue()


def _health(row: Mapping[str, Any]) -> dict[str, Any]:
    battery = row.get("battery") or {}
    return {
        "battery_percent": battery.get("percent"),
        "battery_v": battery.get("voltage_v"),
        "temperature_c": battery.get("temperature_c"),
    }


def _check_header(names: Iterable[str]) -> None:
    present = set(names)
    missing = {"beacon_id", "kind", "floor_id", "x", "y"} - present
    if not present & {"keys", "mac", "uuid"}:
        missing.add("keys")
    unknown = present - {*COLUMNS, *HEALTH_COLUMNS, *KEY_COLUMNS}
    if missing or unknown:
        words = [f"lacks {', '.join(sorted(missing))}"] if missing else []
        words += [f"has unknown {', '.join(sorted(unknown))}"] if unknown else []
        msg = f"the header {' and '.join(words)}"
        raise BeaconTableError(msg)


def _row(line: int, row: Mapping[str | None, Any], separator: str) -> BeaconRow:
    if None in row or None in row.values():
        return BeaconRow(line, {}, "the row has not as many fields as the header")
    cells = {str(name): str(value).strip() for name, value in row.items()}
    try:
        return BeaconRow(line, _fields(cells, separator), unsaid=OPTIONAL - cells.keys())
    except ValueError as error:
        return BeaconRow(line, {"beacon_id": cells["beacon_id"]}, str(error))


def _fields(cells: Mapping[str, str], separator: str) -> dict[str, Any]:
    fields: dict[str, Any] = {
        name: cells[name]
        for name in ("beacon_id", "kind", "name", "floor_id")
        if cells.get(name, "") != ""
    }
    if "name" in fields:
        fields["name"] = cell_text(fields["name"])
    for name in NUMBERS:
        if cells.get(name, "") != "":
            fields[name] = _number(name, cells[name], separator)
    fields["keys"] = list(_keys(cells))
    return fields


def _number(name: str, text: str, separator: str) -> float:
    try:
        text = decimal_text(text, separator)
    except ValueError as error:
        msg = f"{name}: {error}"
        raise ValueError(msg) from error
    try:
        return float(text)
    except ValueError:
        msg = f"{name}: {text!r} is not a number"
        raise ValueError(msg) from None


def _keys(cells: Mapping[str, str]) -> Iterator[str]:
    for text in cells.get("keys", "").split():
        yield canonical_key(text)
    if cells.get("uuid", "") != "":
        major, minor = cells.get("major", ""), cells.get("minor", "")
        if not (major.isdigit() and minor.isdigit()):
            msg = "uuid needs major and minor as whole numbers"
            raise ValueError(msg)
        yield ibeacon_key(cells["uuid"], int(major), int(minor))
    if cells.get("mac", "") != "":
        yield mac_key(cells["mac"])
