"""Traces of the Indoor Location Competition 2.0 as survey walks, read line by line.

One file may hold several traces after each other; each begins with its header.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from app.core.motion.walks import survey_walks
from app.core.survey import Surveyed
from app.core.types import Truth
from app.formats.ms2020 import take_line
from app.formats.survey_places import Reason, SurveyFrame, Unusable, UnusableError, number
from app.formats.trace_samples import TraceSamples

MAX_SAMPLES = 1_000_000
"""An hour and a half of three sensors at 50 Hz; more is no walk, and takes 200 MB."""


@dataclass(slots=True)
class _Walk:
    name: str
    header: dict[str, str] = field(default_factory=dict)
    samples: TraceSamples = field(default_factory=TraceSamples)
    first_line: int = 1
    lines: int = 0


def read_ms2020(
    name: str, lines: Iterable[tuple[int, bytes]], frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the walks of a file, and what of it cannot be used."""
    walk, count = _Walk(trace_name(name)), 0
    for line_number, raw in lines:
        # Network names come in any encoding, and nothing is made of them.
        line = raw.decode("utf-8", "replace")
        if line.startswith("#\tstartTime:") and walk.lines:
            yield from _finished(walk, frame, name)
            count += 1
            walk = _Walk(f"{trace_name(name)}-{count + 1}", first_line=line_number)
        if line.startswith("#"):
            walk.header |= _header(line)
        elif line.strip():
            walk.lines += 1
            try:
                _take(walk, line)
            except UnusableError as error:
                yield Unusable(f"{name}:line {line_number}", error.reason, error.detail)
    if walk.lines:
        yield from _finished(walk, frame, name)


def device_model(head: str) -> str | None:
    """Return brand and model of the phone named in a file's first lines."""
    header: dict[str, str] = {}
    for line in head.splitlines():
        if line.startswith("#"):
            header |= _header(line)
    words = [header[key] for key in ("Brand", "Model") if header.get(key)]
    return " ".join(words)[:100] or None


def _take(walk: _Walk, line: str) -> None:
    if walk.lines > MAX_SAMPLES:
        return
    try:
        take_line(walk.samples, line)
    except (ValueError, IndexError, OverflowError) as error:
        raise UnusableError(Reason.UNREADABLE, str(error)) from error


def _finished(walk: _Walk, frame: SurveyFrame, name: str) -> Iterator[Surveyed | Unusable]:
    place = f"{name}:line {walk.first_line}"
    try:
        truths = list(_truths(walk, frame))
        check_walk(walk.samples, truths, walk.lines)
        observations = [*walk.samples.observations(), *truths]
    except UnusableError as error:
        yield Unusable(place, error.reason, error.detail)
    except (ValueError, OverflowError) as error:
        yield Unusable(place, Reason.UNREADABLE, str(error))
    else:
        yield from survey_walks(walk.name, observations)


def check_walk(samples: TraceSamples, truths: Sequence[Truth], lines: int) -> None:
    """Raise UnusableError unless a map could be made of a walk."""
    if lines > MAX_SAMPLES:
        raise UnusableError(Reason.TOO_LONG, f"{lines} lines")
    if not truths:
        raise UnusableError(Reason.NO_WAYPOINT)
    if not samples.wifi and not samples.beacons:
        raise UnusableError(Reason.NO_SCAN)


def _truths(walk: _Walk, frame: SurveyFrame) -> Iterator[Truth]:
    floor = frame.floor(walk.header.get("FloorName", ""))
    for time_s, x, y in walk.samples.waypoints:
        x_m, y_m = frame.plan_place(floor, number(x, "x"), number(y, "y"))
        yield Truth(time_s, x_m, y_m, floor.floor_id)


def _header(line: str) -> dict[str, str]:
    pairs = (part.partition(":") for part in line[1:].split("\t") if ":" in part)
    return {key.strip(): value.strip() for key, _, value in pairs}


def trace_name(name: str) -> str:
    """Return what a walk is called: its file's name without folders and suffixes."""
    return name.replace("\\", "/").rsplit("/", 1)[-1].split(".", 1)[0][:100] or "trace"
