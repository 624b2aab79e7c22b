"""What a job makes is there exactly when the job says so, whenever the server is killed."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias, TypeVar

import pytest
from sqlalchemy import Connection

from app.core.site import Floor
from app.core.survey import SurveyPoint
from app.formats.survey_places import SurveyFrame
from app.services.job_lane import JobLane
from app.services.jobs import JobBoard
from app.services.radio_map_builds import BuildRequest, RadioMapBuilds
from app.services.survey_import import SurveyImporter
from app.services.survey_parsing import ParseTask
from app.sessions.hub import Hub
from app.storage import radio_maps, surveys
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.floors import StoredFloor, insert_floor
from app.storage.jobs import JobsAsked, StoredJob, list_jobs
from app.storage.sites import StoredSite, insert_site

T = TypeVar("T")
Found: TypeAlias = tuple[int, int, list[str]]
"""How many complete surveys and radio maps there are, and the states of the jobs."""

TABLE = "point,floor_id,x,y,kind,key,rssi_dbm\nP1,hall-0,1,5,wifi,mac:02005e005301,-50\n"
FLOOR = Floor("hall-0", "Ground", "", 0, 0.0, 0.0, 20.0, 10.0)


class StandingClock:
    """A clock that stands still."""

    def now_s(self) -> float:
        """Return some time."""
        return 1_795_314_001.0


def _state(connection: Connection) -> Found:
    complete = surveys.list_surveys(connection, limit=9, after=None)
    maps = radio_maps.list_radio_maps(connection, limit=9)
    states = [job.state for job in list_jobs(connection, JobsAsked(), after=None, limit=9)]
    return len(complete), len(maps), states


def _surveyed_hall(connection: Connection) -> None:
    insert_site(connection, StoredSite("hall", "Hall", 0.0))
    insert_floor(connection, StoredFloor("hall-0", "hall", "Ground", 0, 20.0, 10.0))
    survey = surveys.StoredSurvey("spring", "hall", "Spring", "test", 0.0)
    surveys.begin_survey(connection, survey)
    point = SurveyPoint("P1", "hall-0", 1.0, 5.0, {"mac:02005e005301": -50.0}, {})
    surveys.add_records(connection, "spring", [surveys.points_row([point])])
    surveys.complete_survey(connection, survey)


class WatchedDatabase(Database):
    """Notes after each commit what a server that starts then would find."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self.found: list[Found] = []

    async def write(
        self, statement: Callable[[Connection], T], timeout_s: float | None = None
    ) -> T:
        """Write, and look."""
        value = await super().write(statement, timeout_s)
        self.found.append(await self.read(_state))
        return value


@pytest.mark.anyio
async def test_no_commit_shows_a_survey_whose_job_would_be_begun_again(
    database_url: str, tmp_path: Path
) -> None:
    path = tmp_path / "table.csv"
    path.write_text(TABLE)
    database = WatchedDatabase(database_url)
    await database.write(lambda c: insert_site(c, StoredSite("hall", "Hall", 0.0)))
    clock = StandingClock()
    board = JobBoard(database, Hub(), clock)
    job = await board.open("survey import", "hall", "waiting")
    task = ParseTask(path, "table.csv", SurveyFrame((FLOOR,), None, None))
    await SurveyImporter(database, board, clock).run(job, task, "spring")
    await database.close()
    assert (0, 0, ["running"]) in database.found
    assert database.found[-1] == (1, 0, ["done"])
    assert (1, 0, ["running"]) not in database.found
    assert board.live == ()


@pytest.mark.anyio
async def test_no_commit_shows_a_radio_map_whose_build_would_be_told_as_cut_off(
    database_url: str,
) -> None:
    database = WatchedDatabase(database_url)
    await database.write(_surveyed_hall)
    board = JobBoard(database, Hub(), StandingClock())
    builds = RadioMapBuilds(database, board)
    job = await builds.start(BuildRequest("hall", ()))
    await builds.settle()
    ended = await board.get(job.job_id)
    await database.close()
    assert (1, 0, ["running"]) in database.found
    assert database.found[-1] == (1, 1, ["done"])
    assert (1, 1, ["running"]) not in database.found
    assert ended is not None
    assert (ended.result or {})["version"] == 1
    assert board.live == ()


@pytest.mark.anyio
async def test_a_job_whose_end_the_database_refuses_says_so(database_url: str) -> None:
    database = Database(database_url)
    await database.write(_surveyed_hall)
    board = JobBoard(database, Hub(), StandingClock())
    lane = JobLane(board, "map growth")

    async def refused(_job: StoredJob) -> None:
        msg = "database is locked"
        raise DatabaseUnavailableError(msg)

    job = await lane.start("hall", refused)
    await lane.settle()
    ended = await board.get(job.job_id)
    await database.close()
    assert ended is not None
    assert (ended.state, ended.problem) == (
        "failed",
        {"code": "unavailable", "detail": "database is locked"},
    )
