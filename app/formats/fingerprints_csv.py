"""Fingerprints as a table: CSV with a header line, one level a row.

Columns, in any order: ``point`` (rows of one point make one fingerprint), ``floor_id``, ``x`` and
``y`` (metres in the site frame, the same in all rows of a point), ``key`` (a transmitter key, see
`transmitters`), ``kind`` (wifi or ble) and ``rssi_dbm``. ``walk`` may be left out: fingerprints
surveyed in one go share it. Several levels of one transmitter at one point are averaged.
Semicolons or tabs may separate (`separated_values`).
"""

import csv
import io
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from app.core.survey import SurveyPoint
from app.formats.separated_values import decimal_text, separator_of
from app.formats.transmitters import canonical_key

NEEDED = ("point", "floor_id", "x", "y", "kind", "key", "rssi_dbm")
OPTIONAL = ("walk",)
# What a phone can report: 0 and positive values mean "unknown", weaker than this none reports.
WEAKEST_DBM, STRONGEST_DBM = -127.0, -1.0


class FingerprintTableError(ValueError):
    """The text is not a table of fingerprints; the message names the line."""


@dataclass(slots=True)
class _Levels:
    place: tuple[str, float, float, str]
    of_kind: dict[str, dict[str, list[float]]] = field(
        default_factory=lambda: {"wifi": {}, "ble": {}}
    )


def read_fingerprints_csv(text: str) -> list[SurveyPoint]:
    """Return the points of a table in the order of their first rows.

    Raises
    ------
    FingerprintTableError
        If a column is missing or unknown, or a row cannot be meant; there are no half tables.
    """
    text = text.removeprefix("\ufeff")
    separator = separator_of(text)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator, strict=True)
    points: dict[str, _Levels] = {}
    try:
        _check_header(reader.fieldnames or ())
        for row in reader:
            _take(points, row, separator)
    except (csv.Error, ValueError) as error:
        msg = f"line {max(reader.line_num, 1)}: {error}"
        raise FingerprintTableError(msg) from error
    if not points:
        msg = "the table has no rows"
        raise FingerprintTableError(msg)
    return list(_surveyed(points))


def _check_header(names: Iterable[str]) -> None:
    missing = set(NEEDED) - set(names)
    unknown = set(names) - {*NEEDED, *OPTIONAL}
    if missing or unknown:
        words = [f"lacks {', '.join(sorted(missing))}"] if missing else []
        words += [f"has unknown {', '.join(sorted(unknown))}"] if unknown else []
        msg = f"the header {' and '.join(words)}"
        raise ValueError(msg)


def _take(points: dict[str, _Levels], row: Mapping[str | None, str | None], separator: str) -> None:
    if None in row or None in row.values():
        msg = "the row has not as many fields as the header"
        raise ValueError(msg)
    cells = {str(name): str(value).strip() for name, value in row.items()}
    place = (
        cells["floor_id"],
        _number(cells, "x", separator),
        _number(cells, "y", separator),
        cells.get("walk", ""),
    )
    levels = points.setdefault(cells["point"], _Levels(place))
    if levels.place != place:
        msg = f"point {cells['point']!r} is at another place, or of another walk, than before"
        raise ValueError(msg)
    if cells["kind"] not in levels.of_kind:
        msg = f"kind {cells['kind']!r} is neither wifi nor ble"
        raise ValueError(msg)
    rssi_dbm = _number(cells, "rssi_dbm", separator)
    if not WEAKEST_DBM <= rssi_dbm <= STRONGEST_DBM:
        msg = f"rssi_dbm {rssi_dbm:g} is not in {WEAKEST_DBM:g}..{STRONGEST_DBM:g}"
        raise ValueError(msg)
    levels.of_kind[cells["kind"]].setdefault(canonical_key(cells["key"]), []).append(rssi_dbm)


def _number(cells: Mapping[str, str], name: str, separator: str) -> float:
    text = decimal_text(cells[name], separator)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        msg = f"{name} {cells[name]!r} is not a number"
        raise ValueError(msg)
    return number


def _surveyed(points: Mapping[str, _Levels]) -> Iterator[SurveyPoint]:
    for name, levels in points.items():
        floor_id, x_m, y_m, walk = levels.place
        wifi_dbm, ble_dbm = (
            {key: sum(all_dbm) / len(all_dbm) for key, all_dbm in of_kind.items()}
            for of_kind in (levels.of_kind["wifi"], levels.of_kind["ble"])
        )
        yield SurveyPoint(name, floor_id, x_m, y_m, wifi_dbm, ble_dbm, walk)
