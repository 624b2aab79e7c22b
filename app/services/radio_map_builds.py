"""Builds of radio maps: one at a time, as jobs; the active map stays until another is activated."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

from sqlalchemy import Connection

from app.core.site import Floor
from app.core.survey import Surveyed
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.job_lane import JobLane
from app.services.jobs import JobBoard
from app.services.radio_map_building import BuildOptions, BuiltMap, built_map
from app.services.site import load_site_model
from app.storage import radio_maps, sites, surveys
from app.storage.database import Database
from app.storage.jobs import StoredJob
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap

KIND = "radio map build"
DEFAULT_NAME = "built from surveys"


@dataclass(frozen=True, slots=True)
class BuildRequest:
    """A radio map to build: of which surveys, and how."""

    site_id: str
    surveys: tuple[str, ...]
    name: str = DEFAULT_NAME
    options: BuildOptions = field(default_factory=BuildOptions)


def surveys_to_build(connection: Connection, asked: BuildRequest) -> BuildRequest:
    """Return the request with the surveys it means: those named, or all of the site.

    AppError if the site or a survey is not there, or is of another site.
    """
    found(sites.get_site(connection, asked.site_id), "site", asked.site_id)
    if not asked.surveys:
        every = surveys.list_surveys(connection, site_id=asked.site_id, limit=1_000_000)
        if not every:
            detail = f"site {asked.site_id!r} has no survey to build a radio map of"
            raise AppError(ErrorCode.INVALID_FIELD, detail)
        return replace(asked, surveys=tuple(survey.survey_id for survey in every))
    for i, survey_id in enumerate(asked.surveys):
        survey = surveys.get_survey(connection, survey_id)
        if survey is None or survey.site_id != asked.site_id:
            detail = f"site {asked.site_id!r} has no survey {survey_id!r}"
            raise invalid_field(pointer=f"#/surveys/{i}", detail=detail)
    return asked


def load_surveyed(
    connection: Connection, asked: BuildRequest
) -> tuple[list[Surveyed], Sequence[Floor]]:
    """Return what the surveys hold, and the floors of the site."""
    site = found(load_site_model(connection, asked.site_id), "site", asked.site_id)
    surveyed = [
        record
        for survey_id in asked.surveys
        for record in surveys.records_of_survey(connection, survey_id)
    ]
    return surveyed, site.floors


def storing_built(
    asked: BuildRequest, built: BuiltMap, created_s: float
) -> Callable[[Connection], StoredRadioMap]:
    """Return the statement that stores a built map as the site's next version, not active."""
    provenance = {
        "surveys": list(asked.surveys),
        "options": asdict(asked.options),
        "report": built.report.document(),
    }
    origin = RadioMapOrigin(asked.name, created_s, provenance, built.statistics)

    def statement(connection: Connection) -> StoredRadioMap:
        return radio_maps.save_radio_map(
            connection, asked.site_id, built.radio_map, origin, activate=False
        )

    return statement


class RadioMapBuilds:
    """The builds of a running server, in the order in which they were asked for."""

    def __init__(self, database: Database, board: JobBoard) -> None:
        self._database = database
        self._board = board
        self._lane = JobLane(board, KIND)

    async def start(self, asked: BuildRequest) -> StoredJob:
        """Begin a build and return its job.

        Raises
        ------
        AppError
            If the site or a survey is not there.
        """
        meant = await self._database.read(lambda c: surveys_to_build(c, asked))
        return await self._lane.start(asked.site_id, partial(self._build, asked=meant))

    async def settle(self) -> None:
        """Wait until all builds asked for by now have ended."""
        await self._lane.settle()

    async def close(self) -> None:
        """Give up what has not ended; its jobs fail when the server starts again."""
        await self._lane.close()

    async def _build(self, job: StoredJob, asked: BuildRequest) -> None:
        running = replace(job, state="running", progress={"surveys": len(asked.surveys)})
        await self._board.update(running)
        surveyed, floors = await self._database.read(lambda c: load_surveyed(c, asked))
        read = replace(running, progress={**running.progress, "records": len(surveyed)})
        await self._board.update(read)
        built = await asyncio.to_thread(built_map, surveyed, floors, asked.options)
        ended_s = self._board.now_s
        store = storing_built(asked, built, ended_s)
        # A job cut off between the two would be told as failed, its version being there.
        await self._board.end_with(lambda c: read.done(_result(store(c)), ended_s))


def _result(stored: StoredRadioMap) -> dict[str, Any]:
    return {
        "radio_map_id": stored.radio_map_id,
        "version": stored.version,
        "fingerprints": stored.fingerprints,
        "transmitters": stored.transmitters,
        "report": (stored.provenance or {}).get("report"),
    }
