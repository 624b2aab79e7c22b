"""Levels heard at known places as a table: CSV with a header line, one level a row.

Columns, in any order: ``x``, ``y`` (metres in the site frame), ``rssi_dbm``, and ``beacon_id`` or
``key``; ``device_id`` may be left out or empty. Semicolons or tabs may separate.
"""

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass

from app.formats.separated_values import decimal_text, separator_of
from app.formats.transmitters import canonical_key

NUMBERS = ("x", "y", "rssi_dbm")
NAMES = ("beacon_id", "key")
OPTIONAL = ("device_id",)


class LevelTableError(ValueError):
    """The text is not a table of labelled levels; the message names the line."""


@dataclass(frozen=True, slots=True)
class LevelRow:
    """One level; of ``beacon_id`` and ``key`` one is empty."""

    x_m: float
    y_m: float
    rssi_dbm: float
    beacon_id: str
    key: str
    device_id: str


def read_levels_csv(text: str) -> list[LevelRow]:
    """Return the rows of a table.

    Raises
    ------
    LevelTableError
        If the header lacks a column or a row cannot be meant.
    """
    text = text.removeprefix("\ufeff")
    separator = separator_of(text)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator, strict=True)
    present = set(reader.fieldnames or ())
    if not set(NUMBERS) <= present or not present & set(NAMES):
        msg = f"the header needs {', '.join(NUMBERS)} and beacon_id or key"
        raise LevelTableError(msg)
    try:
        return [_row(row, separator) for row in reader]
    except (ValueError, csv.Error) as error:
        msg = f"line {reader.line_num}: {error}"
        raise LevelTableError(msg) from error


def _row(row: Mapping[str | None, str | None], separator: str) -> LevelRow:
    if None in row or None in row.values():
        msg = "the row has not as many fields as the header"
        raise ValueError(msg)
    x_m, y_m, rssi_dbm = (float(decimal_text(row[name] or "", separator)) for name in NUMBERS)
    if not all(map(math.isfinite, (x_m, y_m, rssi_dbm))):
        msg = "a number is not finite"
        raise ValueError(msg)
    beacon_id, key = ((row.get(name) or "").strip() for name in NAMES)
    if not beacon_id:
        key = canonical_key(key)
    return LevelRow(x_m, y_m, rssi_dbm, beacon_id, key, (row.get("device_id") or "").strip())
