"""An uploaded survey is read in a process of its own: what it costs, phones do not wait for.

The process sends what it found through a pipe, a bounded amount at a time, and knows no database.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.formats.survey_ms2020 import device_model
from app.formats.survey_places import (
    Reason,
    SurveyFrame,
    Unusable,
    UploadError,
)
from app.formats.survey_uploads import (
    HEAD_BYTES,
    SurveyFormat,
    UnknownFormat,
    format_of,
    read_survey,
)
from app.formats.upload_streams import Member, members
from app.storage.surveys import Holding, RecordRow, points_row, walk_row

FIRST_UNUSABLE = 100
"""So many are listed with their places; the counts say how many more there are."""
MAX_TRANSMITTERS = 200_000
"""A city has fewer; a file with more is no survey, and would fill the memory with their names."""
POINTS_PER_ROW, OPEN_ROWS = 200, 64
ROWS_BYTES = 1 << 20
PROGRESS_STEPS = 100


@dataclass(frozen=True, slots=True)
class ParseTask:
    """What to read: the file as it was received, and the site it belongs to."""

    path: Path
    name: str
    frame: SurveyFrame


@dataclass(frozen=True, slots=True)
class Rows:
    """Records to store."""

    rows: list[RecordRow]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far it is: bytes read of the file as sent, walks and fingerprints found."""

    read_bytes: int
    traces: int
    fingerprints: int
    unusable: int


@dataclass(frozen=True, slots=True)
class Parsed:
    """The last message of a file that holds a survey."""

    formats: tuple[str, ...]
    device_model: str | None
    holdings: tuple[Holding, ...]
    unusable: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Refused:
    """The last message of a file that holds none."""

    detail: str
    unusable: dict[str, Any]


Message: TypeAlias = Rows | Progress | Parsed | Refused


def send_parsed(task: ParseTask, connection: Connection) -> None:
    """Run as the process: read the file and send what is found."""
    # Phones come first; a refusal to be nicer would only make them wait.
    os.nice(10)
    for message in parse_upload(task):
        connection.send(message)
    connection.close()


def parse_upload(task: ParseTask) -> Iterator[Message]:
    """Yield what a file holds; the last message is `Parsed` or `Refused`."""
    found = SurveyTally()
    size = task.path.stat().st_size
    try:
        with task.path.open("rb") as file:
            yield from _messages(task, file, size, found)
    except UploadError as error:
        yield Refused(str(error), found.unusable())
        return
    if not found.holdings():
        yield Refused("nothing in it can be used", found.unusable())
        return
    yield Progress(size, found.traces, found.fingerprints, found.unusable_count)
    yield Parsed(tuple(found.formats), found.device_model, found.holdings(), found.unusable())


def _messages(
    task: ParseTask, file: BinaryIO, size: int, found: "SurveyTally"
) -> Iterator[Message]:
    rows = _RowWriter()
    step = max(size // PROGRESS_STEPS, 1)
    told = 0
    for record in _records(task, file, size, found):
        found.count(record)
        if not isinstance(record, Unusable):
            rows.add(record)
        if rows.full:
            yield Rows(rows.taken())
        position = file.tell()
        if position - told >= step:
            told = position
            yield Progress(told, found.traces, found.fingerprints, found.unusable_count)
    yield Rows(rows.flushed())


def _records(
    task: ParseTask, file: BinaryIO, size: int, found: "SurveyTally"
) -> Iterator[Surveyed | Unusable]:
    for member in members(task.name, file, size):
        if isinstance(member, Unusable):
            yield member
            continue
        head = member.stream.peek(HEAD_BYTES)[:HEAD_BYTES]
        survey_format = format_of(head)
        if isinstance(survey_format, UnknownFormat):
            yield Unusable(member.name, Reason.UNKNOWN_FORMAT, survey_format.reason)
            continue
        yield from _of_format(survey_format, member, head, task.frame, found)


def _of_format(
    survey_format: SurveyFormat,
    member: Member,
    head: bytes,
    frame: SurveyFrame,
    found: "SurveyTally",
) -> Iterator[Surveyed | Unusable]:
    found.formats[survey_format.value] = None
    if survey_format is SurveyFormat.MS2020 and found.device_model is None:
        found.device_model = device_model(head.decode("utf-8", "replace"))
    return read_survey(survey_format, member.name, member.stream, frame)


@dataclass(slots=True)
class _FloorTally:
    walks: int = 0
    scans: int = 0
    fingerprints: int = 0
    transmitters: set[str] = field(default_factory=set)
    times: list[float] = field(default_factory=list)

    def see(self, *times_s: float) -> None:
        self.times = [
            min(*self.times, *times_s, times_s[0]),
            max(*self.times, *times_s, times_s[0]),
        ]


@dataclass(slots=True)
class SurveyTally:
    """Counts what was found, and keeps the first of what cannot be used."""

    formats: dict[str, None] = field(default_factory=dict)
    device_model: str | None = None
    traces: int = 0
    fingerprints: int = 0
    unusable_count: int = 0
    _floors: dict[str, _FloorTally] = field(default_factory=dict)
    _transmitters: int = 0
    _reasons: Counter[Reason] = field(default_factory=Counter)
    _first: list[Unusable] = field(default_factory=list)

    def count(self, record: Surveyed | Unusable) -> None:
        """Take note of a record; UploadError once there are too many transmitters."""
        if isinstance(record, Unusable):
            self._count_unusable(record)
            return
        floor = self._floors.setdefault(record.floor_id, _FloorTally())
        before = len(floor.transmitters)
        if isinstance(record, SurveyWalk):
            self.traces += 1
            floor.walks += 1
            floor.scans += len(record.scans)
            floor.transmitters.update(r.keys[0] for s in record.scans for r in s.readings)
            floor.see(*record.span_s)
        else:
            self.fingerprints += 1
            floor.fingerprints += 1
            floor.transmitters.update(record.wifi_dbm, record.ble_dbm)
            if record.time_s is not None:
                floor.see(record.time_s)
        self._transmitters += len(floor.transmitters) - before
        if self._transmitters > MAX_TRANSMITTERS:
            msg = f"it names more than {MAX_TRANSMITTERS} transmitters"
            raise UploadError(msg)

    def holdings(self) -> tuple[Holding, ...]:
        """Return what was found per floor."""
        return tuple(
            Holding(
                floor_id=floor_id,
                walks=floor.walks,
                scans=floor.scans,
                fingerprints=floor.fingerprints,
                transmitters=len(floor.transmitters),
                first_s=floor.times[0] if floor.times else None,
                last_s=floor.times[1] if floor.times else None,
            )
            for floor_id, floor in sorted(self._floors.items())
        )

    def unusable(self) -> dict[str, Any]:
        """Return, as JSON, the counts by reason and the first places with their words."""
        first = [
            {"place": u.place[-200:], "reason": u.reason.value, "detail": _sendable(u.detail)}
            for u in self._first
        ]
        counts = {reason.value: count for reason, count in self._reasons.most_common()}
        return {"counts": counts, "first": first}

    def _count_unusable(self, record: Unusable) -> None:
        self.unusable_count += 1
        self._reasons[record.reason] += 1
        if len(self._first) < FIRST_UNUSABLE:
            self._first.append(record)


def _sendable(text: str) -> str:
    # What a file brings may hold what JSON columns refuse: NULs, halves of surrogate pairs.
    return text[:200].encode("ascii", "backslashreplace").decode().replace("\0", "\\0")


@dataclass(slots=True)
class _RowWriter:
    """Joins points to rows, a few hundred of a floor and walk each."""

    _points: dict[tuple[str, str], list[SurveyPoint]] = field(default_factory=dict)
    _rows: list[RecordRow] = field(default_factory=list)
    _bytes: int = 0

    @property
    def full(self) -> bool:
        return self._bytes >= ROWS_BYTES

    def add(self, record: Surveyed) -> None:
        if isinstance(record, SurveyWalk):
            self._append(walk_row(record))
            return
        key = record.floor_id, record.walk
        points = self._points.setdefault(key, [])
        points.append(record)
        if len(points) >= POINTS_PER_ROW:
            self._append(points_row(self._points.pop(key)))
        elif len(self._points) > OPEN_ROWS:
            self._close_points()

    def taken(self) -> list[RecordRow]:
        rows, self._rows, self._bytes = self._rows, [], 0
        return rows

    def flushed(self) -> list[RecordRow]:
        self._close_points()
        return self.taken()

    def _close_points(self) -> None:
        for points in self._points.values():
            self._append(points_row(points))
        self._points.clear()

    def _append(self, row: RecordRow) -> None:
        self._rows.append(row)
        self._bytes += len(row["payload"])


def tally_of(records: Iterable[Surveyed | Unusable]) -> SurveyTally:
    """Return the counts of some records."""
    tally = SurveyTally()
    for record in records:
        tally.count(record)
    return tally
