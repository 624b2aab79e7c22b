"""Long work that its owner can watch: stored, and told to all who listen to the topic of jobs."""

from uuid import uuid4

from app.services.writing import write
from app.sessions.hub import Hub, Topic
from app.sessions.ports import Clock
from app.storage import jobs
from app.storage.database import Database
from app.storage.jobs import StoredJob

CUT_OFF = {"code": "server_stopped", "detail": "the server was stopped meanwhile; send it again"}


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

    async def get(self, job_id: str) -> StoredJob | None:
        """Return a job."""
        live = self._live.get(job_id)
        if live is not None:
            return live
        return await self._database.read(lambda c: jobs.get_job(c, job_id))

    async def fail_cut_off(self) -> None:
        """Fail, at the start, the jobs that the end of the server cut off."""
        now_s = self._clock.now_s()
        await self._database.write(lambda c: jobs.fail_unended(c, CUT_OFF, now_s))

    def _tell(self, job: StoredJob) -> None:
        if job.ended:
            self._live.pop(job.job_id, None)
        else:
            self._live[job.job_id] = job
        self._hub.publish_event(Topic.JOBS, job, job.site_id)
