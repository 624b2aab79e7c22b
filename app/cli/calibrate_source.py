"""Labelled levels for ``pharos calibrate``: of a survey, a session, or recorded traces."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from app.cli.errors import CommandError
from app.cli.local import CLOCK, local_database
from app.formats.ms2020 import Trace, read_trace
from app.services import calibration_drafts as drafts
from app.services import calibration_sources as sources
from app.services.calibration_drafts import PlacesRequest
from app.services.calibration_sources import Labelled
from app.services.errors import found
from app.services.planning_queue import PlanQueue
from app.storage import floors
from app.storage.calibrations import StoredCalibration
from app.storage.database import Database
from app.storage.floors import StoredFloor

SurveyOption = Annotated[str | None, typer.Option(metavar="ID", help="Source: a stored survey.")]
DeviceOption = Annotated[
    str | None,
    typer.Option(
        metavar="ID",
        help="Source: a phone's session with truth records. With --trace: who recorded it.",
    ),
]
SessionOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Which session of --device; left out: its newest."),
]
TraceOption = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE", help="Source: a trace with waypoints, as of ms2020; may be repeated."
    ),
]


@dataclass(frozen=True, slots=True)
class AskedSource:
    """The options that say where labelled levels are."""

    survey_id: str | None = None
    device_id: str | None = None
    session: str | None = None
    traces: tuple[Path, ...] = ()

    @property
    def is_named(self) -> bool:
        """Tell whether any of them was given."""
        return any((self.survey_id, self.device_id, self.session, self.traces))


def drafted_levels(database: str | None, floor_id: str, source: AskedSource) -> StoredCalibration:
    """Calibrate the beacons of a floor and store the draft."""

    async def draft(store: Database, floor: StoredFloor, labelled: Labelled) -> StoredCalibration:
        return await drafts.draft_levels(store, PlanQueue(), floor, labelled, CLOCK.now_s())

    return _drafted(database, floor_id, source, draft)


def drafted_places(
    database: str | None, floor_id: str, source: AskedSource, asked: PlacesRequest
) -> StoredCalibration:
    """Estimate the places of beacons on a floor and store the draft."""

    async def draft(store: Database, floor: StoredFloor, labelled: Labelled) -> StoredCalibration:
        return await drafts.draft_places(store, PlanQueue(), floor, labelled, asked, CLOCK.now_s())

    return _drafted(database, floor_id, source, draft)


def _drafted(
    database: str | None,
    floor_id: str,
    source: AskedSource,
    draft: Callable[[Database, StoredFloor, Labelled], Awaitable[StoredCalibration]],
) -> StoredCalibration:
    _check(source)

    async def work(store: Database) -> StoredCalibration:
        floor = found(await store.read(lambda c: floors.get_floor(c, floor_id)), "floor", floor_id)
        return await draft(store, floor, await _labelled(store, floor, source))

    with local_database(database) as store:
        return asyncio.run(work(store))


def _check(source: AskedSource) -> None:
    named = [bool(source.survey_id), bool(source.traces)]
    from_session = source.device_id is not None and not source.traces
    if [*named, from_session].count(True) != 1:
        msg = "one source is needed: --survey, --device or --trace"
        raise CommandError(msg, 2)
    if source.session is not None and not from_session:
        msg = "--session is of a --device"
        raise CommandError(msg, 2)


async def _labelled(store: Database, floor: StoredFloor, source: AskedSource) -> Labelled:
    if source.survey_id is not None:
        return await sources.of_survey(store, floor.site_id, source.survey_id)
    if source.traces:
        return _of_traces(source.traces, floor, source.device_id or "")
    if source.device_id is None:
        msg = "--device is needed"
        raise CommandError(msg, 2)
    return await sources.of_session(store, floor.site_id, source.device_id, source.session)


def _of_traces(paths: Sequence[Path], floor: StoredFloor, device_id: str) -> Labelled:
    walked = [sources.traced(_trace(path), floor, device_id) for path in paths]
    records = tuple(record for one in walked for record in one.records)
    names = [str(one.described["trace"]) for one in walked]
    return Labelled({"traces": names}, device_id, records)


def _trace(path: Path) -> Trace:
    try:
        return read_trace(path)
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read: {error}"
        raise CommandError(msg) from error
