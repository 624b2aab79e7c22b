"""A survey is there exactly when its job says so, whenever the server is killed."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias, TypeVar

import pytest
from sqlalchemy import Connection

from app.core.site import Floor
from app.formats.survey_places import SurveyFrame
from app.services.jobs import JobBoard
from app.services.survey_import import SurveyImporter
from app.services.survey_parsing import ParseTask
from app.sessions.hub import Hub
from app.storage import surveys
from app.storage.database import Database
from app.storage.jobs import JobsAsked, list_jobs
from app.storage.sites import StoredSite, insert_site

T = TypeVar("T")
Found: TypeAlias = tuple[int, list[str]]
"""How many complete surveys there are, and the states of the jobs."""

TABLE = "point,floor_id,x,y,kind,key,rssi_dbm\nP1,hall-0,1,5,wifi,mac:02005e005301,-50\n"
FLOOR = Floor("hall-0", "Ground", "", 0, 0.0, 0.0, 20.0, 10.0)


class StandingClock:
    """A clock that stands still."""

    def now_s(self) -> float:
        """Return some time."""
        return 1_795_314_001.0


def _state(connection: Connection) -> Found:
    complete = surveys.list_surveys(connection, limit=9, after=None)
    return len(complete), [j.state for j in list_jobs(connection, JobsAsked(), after=None, limit=9)]


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
    assert (0, ["running"]) in database.found
    assert database.found[-1] == (1, ["done"])
    assert (1, ["running"]) not in database.found
    assert board.live == ()
