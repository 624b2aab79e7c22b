"""Point surveys as tables, read row by row: our CSV, wide CSV of access points, Anyplace's text."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from app.core.site import Floor
from app.core.survey import Surveyed, SurveyPoint
from app.formats.fingerprints_csv import NEEDED, OPTIONAL
from app.formats.separated_values import DECIMAL_COMMA_SEPARATOR, decimal_text, separator_of
from app.formats.survey_places import (
    Reason,
    SurveyFrame,
    Unusable,
    UnusableError,
    UploadError,
    number,
    plain_name,
    surveyed_level,
)
from app.formats.transmitters import canonical_key, mac_key

MAX_COLUMNS = 20_000
_NUMBERS = ("x", "y", "rssi_dbm")
_WIDE_NAMES = ("FLOOR", "BUILDINGID", "PHONEID")
MAX_READINGS = 5_000
"""Of one point; a scan in a tower's middle hears a few hundred."""


@dataclass(slots=True)
class GatheredPoint:
    """A point whose rows are still coming in; several levels of a transmitter are averaged."""

    point: str
    floor: Floor
    x_m: float
    y_m: float
    walk: str = ""
    time_s: float | None = None
    levels: dict[str, dict[str, list[float]]] = field(
        default_factory=lambda: {"wifi": {}, "ble": {}}
    )
    readings: int = 0

    def hear(self, kind: str, key: str, rssi_dbm: float) -> None:
        """Add a level."""
        if kind not in self.levels:
            raise UnusableError(Reason.BAD_KIND, repr(kind))
        if self.readings >= MAX_READINGS:
            raise UnusableError(Reason.TOO_MANY_READINGS, self.point)
        self.readings += 1
        self.levels[kind].setdefault(key, []).append(rssi_dbm)

    def surveyed(self) -> SurveyPoint:
        """Return the fingerprint; UnusableError if nothing was heard."""
        if not self.readings:
            raise UnusableError(Reason.NOTHING_HEARD, self.point)
        wifi_dbm, ble_dbm = (
            {key: sum(dbm) / len(dbm) for key, dbm in self.levels[kind].items()}
            for kind in ("wifi", "ble")
        )
        return SurveyPoint(
            point=self.point,
            floor_id=self.floor.floor_id,
            x_m=self.x_m,
            y_m=self.y_m,
            wifi_dbm=wifi_dbm,
            ble_dbm=ble_dbm,
            walk=self.walk,
            time_s=self.time_s,
        )


def read_long_csv(
    name: str, lines: Iterable[tuple[int, bytes]], frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the points of our own CSV; rows of a point that stand together make a fingerprint."""
    rows = iter(lines)
    header, separator = _header(rows)
    missing = set(NEEDED) - set(header)
    if missing or set(header) - {*NEEDED, *OPTIONAL}:
        msg = f"the header has to be {','.join(NEEDED)} and, if need be, walk"
        raise UploadError(msg)
    gathered: GatheredPoint | None = None
    written: tuple[str, ...] = ()
    for line_number, raw in rows:
        place = f"{name}:line {line_number}"
        try:
            cells = _named_cells(header, raw, separator)
            key = tuple(cells.get(c, "") for c in ("point", "floor_id", "x", "y", "walk"))
            if gathered is None or key != written:
                begun = _begun(cells, frame)
                if gathered is not None and gathered.readings:
                    yield gathered.surveyed()
                gathered, written = begun, key
            rssi_dbm = surveyed_level(cells["rssi_dbm"])
            gathered.hear(cells["kind"].strip(), canonical_key(cells["key"]), rssi_dbm)
        except UnusableError as error:
            yield Unusable(place, error.reason, error.detail)
        except (ValueError, csv.Error) as error:
            yield Unusable(place, Reason.UNREADABLE, str(error))
    if gathered is not None and gathered.readings:
        yield gathered.surveyed()


def _named_cells(header: list[str], raw: bytes, separator: str) -> dict[str, str]:
    cells = dict(zip(header, _cells(raw, separator), strict=True))
    if separator == DECIMAL_COMMA_SEPARATOR:
        cells |= {column: decimal_text(cells[column], separator) for column in _NUMBERS}
    return cells


def _begun(cells: dict[str, str], frame: SurveyFrame) -> GatheredPoint:
    floor = frame.floor(cells["floor_id"])
    x_m, y_m = frame.place(floor, number(cells["x"], "x"), number(cells["y"], "y"))
    return GatheredPoint(
        plain_name(cells["point"]), floor, x_m, y_m, plain_name(cells.get("walk", ""))
    )


@dataclass(frozen=True, slots=True)
class _WideHeader:
    columns: dict[str, int]
    access_points: tuple[tuple[int, str], ...]
    width: int
    separator: str

    def cell(self, cells: Sequence[str], name: str) -> str:
        return cells[self.columns[name]] if name in self.columns else ""

    def pointed(self, cells: list[str]) -> list[str]:
        """Return the cells of a row, the decimals of numbers behind a point."""
        if self.separator != DECIMAL_COMMA_SEPARATOR:
            return cells
        names = {self.columns[name] for name in _WIDE_NAMES if name in self.columns}
        return [
            cell if i in names else decimal_text(cell, self.separator)
            for i, cell in enumerate(cells)
        ]


def read_wide_csv(
    name: str, lines: Iterable[tuple[int, bytes]], frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the points of a wide table: a column per access point, 100 where it was not heard."""
    rows = iter(lines)
    header = _wide_header(*_header(rows))
    for line_number, raw in rows:
        try:
            cells = _cells(raw, header.separator)
            yield _wide_point(header, cells, frame, f"row {line_number - 1}")
        except UnusableError as error:
            yield Unusable(f"{name}:line {line_number}", error.reason, error.detail)
        except (ValueError, csv.Error) as error:
            yield Unusable(f"{name}:line {line_number}", Reason.UNREADABLE, str(error))


def _wide_header(names: list[str], separator: str) -> _WideHeader:
    columns = {column.strip().upper(): i for i, column in enumerate(names)}
    access_points = [(i, column.strip()) for i, column in enumerate(names) if _is_wap(column)]
    places = [("X", "Y"), ("LONGITUDE", "LATITUDE")]
    if not any(x in columns and y in columns for x, y in places) or "FLOOR" not in columns:
        msg = "a wide table needs the columns FLOOR and X, Y or LONGITUDE, LATITUDE"
        raise UploadError(msg)
    try:
        keyed = tuple((i, _wap_key(column)) for i, column in access_points)
    except ValueError as error:
        msg = f"the header names no access point: {error}"
        raise UploadError(msg) from error
    return _WideHeader(columns, keyed, len(names), separator)


def _is_wap(column: str) -> bool:
    name = column.strip().upper()
    return name.startswith(("WAP", "MAC:")) or name.count(":") == 5


def _wap_key(column: str) -> str:
    if column.upper().startswith("WAP"):
        # Names that stand for access points whose addresses were taken out.
        return f"name:{column.lower()[:60]}"
    return canonical_key(column) if column.lower().startswith("mac:") else mac_key(column)


def _wide_point(
    header: _WideHeader, cells: list[str], frame: SurveyFrame, point: str
) -> SurveyPoint:
    if len(cells) != header.width:
        raise UnusableError(Reason.FIELD_COUNT)
    cells = header.pointed(cells)
    floor = frame.floor(header.cell(cells, "FLOOR"), header.cell(cells, "BUILDINGID"))
    if "X" in header.columns:
        x_m, y_m = number(header.cell(cells, "X"), "X"), number(header.cell(cells, "Y"), "Y")
        x_m, y_m = frame.place(floor, x_m, y_m)
    else:
        east_m = number(header.cell(cells, "LONGITUDE"), "LONGITUDE")
        north_m = number(header.cell(cells, "LATITUDE"), "LATITUDE")
        x_m, y_m = frame.mercator_place(floor, east_m, north_m)
    time = header.cell(cells, "TIMESTAMP")
    gathered = GatheredPoint(point, floor, x_m, y_m)
    gathered.time_s = number(time, "TIMESTAMP") if time else None
    gathered.walk = plain_name(header.cell(cells, "PHONEID"))
    for i, key in header.access_points:
        cell = cells[i].strip()
        if cell not in {"100", "100.0", ""}:
            gathered.hear("wifi", key, surveyed_level(cell))
    return gathered.surveyed()


def read_anyplace(
    name: str, lines: Iterable[tuple[int, bytes]], frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the points of Anyplace's radio-map text: rows of one time and place are one scan.

    ``Timestamp, X, Y, HEADING, MAC Address of AP, RSS, FLOOR``, X the latitude, Y the longitude.
    """
    gathered: GatheredPoint | None = None
    written: tuple[str, ...] = ()
    for line_number, raw in lines:
        line = raw.decode("utf-8", "replace").removeprefix("\ufeff").strip()
        if not line or line.startswith("#"):
            continue
        try:
            fields = line.replace(",", " ").split()
            time, lat, lon, heading, mac, rss, floor_name = fields
            key = (time, lat, lon, heading, floor_name)
            if gathered is None or key != written:
                begun = _anyplace_point(key, frame, f"row {line_number}")
                if gathered is not None and gathered.readings:
                    yield gathered.surveyed()
                gathered, written = begun, key
            gathered.hear("wifi", mac_key(mac), surveyed_level(rss))
        except UnusableError as error:
            yield Unusable(f"{name}:line {line_number}", error.reason, error.detail)
        except ValueError as error:
            yield Unusable(f"{name}:line {line_number}", Reason.UNREADABLE, str(error))
    if gathered is not None and gathered.readings:
        yield gathered.surveyed()


def _anyplace_point(key: tuple[str, ...], frame: SurveyFrame, point: str) -> GatheredPoint:
    time, lat, lon, _heading, floor_name = key
    floor = frame.floor(floor_name)
    x_m, y_m = frame.globe_place(floor, number(lat, "X"), number(lon, "Y"))
    time_s = number(time, "the timestamp") / 1000.0
    return GatheredPoint(point, floor, x_m, y_m, time_s=time_s)


def _header(rows: Iterator[tuple[int, bytes]]) -> tuple[list[str], str]:
    try:
        raw = next(rows)[1].removeprefix(b"\xef\xbb\xbf")
        separator = separator_of(raw.decode("utf-8", "replace"))
        return _cells(raw, separator), separator
    except (ValueError, csv.Error, StopIteration) as error:
        msg = f"the header cannot be read ({error})"
        raise UploadError(msg) from error


def _cells(raw: bytes, separator: str) -> list[str]:
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnusableError(Reason.NOT_UTF8) from error
    if "\0" in text:
        raise UnusableError(Reason.UNREADABLE, "a NUL in it")
    # Nine tables of ten quote nothing, and take a third of the time.
    quoted = '"' in text
    if quoted:
        cells = next(csv.reader(io.StringIO(text), delimiter=separator, strict=True), [])
    else:
        cells = text.split(separator)
    if len(cells) > MAX_COLUMNS:
        raise UnusableError(Reason.FIELD_COUNT, f"more than {MAX_COLUMNS}")
    return cells
