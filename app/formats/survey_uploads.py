"""Any survey file: its format is found by its content, its records are read one by one."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from io import BufferedReader

from app.core.survey import Surveyed
from app.formats.getsensordata import read_getsensordata
from app.formats.survey_json import read_geosubmit, read_points_json
from app.formats.survey_ms2020 import read_ms2020
from app.formats.survey_places import SurveyFrame, Unusable
from app.formats.survey_tables import read_anyplace, read_long_csv, read_wide_csv
from app.formats.upload_streams import numbered_lines

HEAD_BYTES = 1 << 14
_UTF16 = (b"\xff\xfe", b"\xfe\xff")


class SurveyFormat(StrEnum):
    """Formats that surveys come in."""

    MS2020 = "ms2020"
    CSV = "csv"
    WIDE_CSV = "wide-csv"
    JSON = "json"
    GETSENSORDATA = "getsensordata"
    GEOSUBMIT = "geosubmit"
    ANYPLACE = "anyplace"


@dataclass(frozen=True, slots=True)
class UnknownFormat:
    """Why a file is of no known format."""

    reason: str


_SIGNS: tuple[tuple[SurveyFormat, re.Pattern[str]], ...] = (
    (SurveyFormat.MS2020, re.compile(r"\A#\tstartTime:|^\d{12,14}\tTYPE_", re.MULTILINE)),
    (SurveyFormat.ANYPLACE, re.compile(r"\A#\s*Timestamp\s*,\s*X\s*,\s*Y\s*,\s*HEADING", re.I)),
    (
        SurveyFormat.GETSENSORDATA,
        re.compile(r"^(ACCE|GYRO|MAGN|AHRS|WIFI|BLE4|POSI|PRES);-?\d", re.MULTILINE),
    ),
    (SurveyFormat.GEOSUBMIT, re.compile(r'\A\s*\{.*"items"\s*:\s*\[', re.DOTALL)),
    (SurveyFormat.JSON, re.compile(r'\A\s*\{.*"points"\s*:\s*\[', re.DOTALL)),
    (SurveyFormat.WIDE_CSV, re.compile(r"\A(?=[^\n]*\bFLOOR\b)[^\n]*\bWAP\d", re.I)),
    (SurveyFormat.WIDE_CSV, re.compile(r"\A(?=[^\n]*\bFLOOR\b)[^\n]*([0-9a-f]{2}:){5}", re.I)),
    (SurveyFormat.CSV, re.compile(r"\A(?=[^\n]*\bpoint\b)[^\n]*\brssi_dbm\b")),
)


def format_of(head: bytes) -> SurveyFormat | UnknownFormat:
    """Return the format of a file that begins with ``head``."""
    if not head.strip():
        return UnknownFormat("the file is empty")
    if head.startswith(_UTF16):
        return UnknownFormat("the file is UTF-16; send UTF-8")
    text = head.decode("utf-8", "replace").removeprefix("\ufeff")
    for survey_format, sign in _SIGNS:
        if sign.search(text):
            return survey_format
    if "\0" in text:
        return UnknownFormat("the file is binary, of no known format")
    return UnknownFormat(f"the file is of no known format ({', '.join(SurveyFormat)})")


def read_survey(
    survey_format: SurveyFormat, name: str, stream: BufferedReader, frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield walks and points of a file in the order they are in it, and what cannot be used.

    Raises
    ------
    UploadError
        If the file as a whole cannot be read.
    """
    if survey_format is SurveyFormat.JSON:
        return read_points_json(name, stream, frame)
    if survey_format is SurveyFormat.GEOSUBMIT:
        return read_geosubmit(name, stream, frame)
    return _LINE_READERS[survey_format](name, numbered_lines(stream), frame)


LineReader = Callable[
    [str, Iterator[tuple[int, bytes]], SurveyFrame], Iterator[Surveyed | Unusable]
]
_LINE_READERS: dict[SurveyFormat, LineReader] = {
    SurveyFormat.MS2020: read_ms2020,
    SurveyFormat.GETSENSORDATA: read_getsensordata,
    SurveyFormat.CSV: read_long_csv,
    SurveyFormat.WIDE_CSV: read_wide_csv,
    SurveyFormat.ANYPLACE: read_anyplace,
}
