"""Long work that its owner can watch: stored, and told to all who listen to the topic of jobs."""

import logging
from collections.abc import Callable, Collection
from uuid import uuid4

from sqlalchemy import Connection

from app.services.writing import write
from app.sessions.hub import Hub, Topic
from app.sessions.ports import Clock
from app.storage import jobs
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.jobs import JobKey, JobsAsked, StoredJob

_LOG = logging.getLogger(__name__)

SERVER_STOPPED = "server_stopped"
CUT_OFF = {
    "code": SERVER_STOPPED,
    "detail": "the server was stopped before it had ended; nothing was changed, ask for it again",
}


class JobBoard:
    """Every change of a job goes through here."""

    def __init__(self, database: Database, hub: Hub, clock: Clock) -> None:
        self._database = database
        self._hub = hub
        self._clock = clock
        self._live: dict[str, StoredJob] = {}

    @property
    def now_s(self) -> float:
        """Return the time of the server's clock."""
        return self._clock.now_s()

    @property
    def live(self) -> tuple[StoredJob, ...]:
        """Return the jobs that have not ended."""
        return tuple(self._live.values())

    async def open(self, kind: str, site_id: str, state: str) -> StoredJob:
        """Add a job."""
        job = StoredJob(uuid4().hex, site_id, kind, state, self._clock.now_s())
        await write(self._database, lambda c: jobs.insert_job(c, job))
        self._tell(job)
        return job

    async def update(self, job: StoredJob) -> None:
        """Store and tell how a job stands now."""
        await self._database.write(lambda c: jobs.update_job(c, job))
        self._tell(job)

    async def page(self, asked: JobsAsked, *, after: JobKey | None, limit: int) -> list[StoredJob]:
        """Return up to ``limit + 1`` jobs, the newest first."""
        return await self._database.read(
            lambda c: jobs.list_jobs(c, asked, after=after, limit=limit)
        )

    async def get(self, job_id: str) -> StoredJob | None:
        """Return a job."""
        live = self._live.get(job_id)
        if live is not None:
            return live
        return await self._database.read(lambda c: jobs.get_job(c, job_id))

    async def end(self, job: StoredJob) -> None:
        """Store and tell how a job ended; if the database takes no writes now, once it does."""
        try:
            await self._database.write(lambda c: jobs.update_job(c, job))
        except DatabaseUnavailableError as error:
            _LOG.warning("the end of job %s is stored later: %s", job.job_id, error)
            self._database.submit(lambda c: jobs.update_job(c, job))
        self._tell(job)

    async def end_with(self, outcome: Callable[[Connection], StoredJob]) -> None:
        """Store what came of a job together with its end: no kill leaves one without the other.

        ``outcome`` stores the one and returns the job as it has ended by that.
        """

        def statement(connection: Connection) -> StoredJob:
            job = outcome(connection)
            jobs.update_job(connection, job)
            return job

        self._tell(await self._database.write(statement))

    async def fail_cut_off(self, but: Collection[str]) -> None:
        """Fail, at the start, the jobs that the end of the server cut off, ``but`` these."""
        now_s = self._clock.now_s()
        await self._database.write(lambda c: jobs.fail_unended(c, CUT_OFF, now_s, but))

    def _tell(self, job: StoredJob) -> None:
        if job.ended:
            self._live.pop(job.job_id, None)
        else:
            self._live[job.job_id] = job
        self._hub.publish_event(Topic.JOBS, job, job.site_id)
