"""Long work as stored: what it does, how far it is, what came of it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

from sqlalchemy import Connection, RowMapping, insert, select, tuple_, update

from app.storage.tables import JOBS

ENDED = ("done", "failed")

JobKey: TypeAlias = tuple[float, str]
"""Where a page of the list ends: when its last job was made, and the job's id."""


@dataclass(frozen=True, slots=True)
class StoredJob:
    """A job.

    Attributes
    ----------
    state
        ``receiving`` (its upload), ``waiting``, ``running``, ``done`` or ``failed``.
    progress
        Numbers that grow while it runs, by name.
    result
        What came of it, as JSON, once it is done.
    problem
        ``code`` and ``detail``, once it failed.
    """

    job_id: str
    site_id: str
    kind: str
    state: str
    created_s: float
    progress: dict[str, int] = field(default_factory=dict)
    result: dict[str, Any] | None = None
    problem: dict[str, Any] | None = None
    ended_s: float | None = None

    @property
    def ended(self) -> bool:
        """Tell whether nothing more will come of it."""
        return self.state in ENDED

    def done(self, result: dict[str, Any], ended_s: float) -> "StoredJob":
        """Return the job as it is when its work is done."""
        return replace(self, state="done", result=result, ended_s=ended_s)

    def failed(self, code: str, detail: str, ended_s: float, **more: object) -> "StoredJob":
        """Return the job as it is when it came to nothing."""
        problem = {"code": code, "detail": detail, **more}
        return replace(self, state="failed", problem=problem, ended_s=ended_s)


@dataclass(frozen=True, slots=True)
class JobsAsked:
    """Which jobs to list; None: any."""

    site_id: str | None = None
    kind: str | None = None
    state: str | None = None


def insert_job(connection: Connection, job: StoredJob) -> None:
    """Add a job."""
    connection.execute(insert(JOBS).values(id=job.job_id, **_values(job)))


def update_job(connection: Connection, job: StoredJob) -> None:
    """Store how a job stands now."""
    connection.execute(update(JOBS).where(JOBS.c.id == job.job_id).values(**_values(job)))


def get_job(connection: Connection, job_id: str) -> StoredJob | None:
    """Return a job."""
    row = connection.execute(select(JOBS).where(JOBS.c.id == job_id)).mappings().one_or_none()
    return None if row is None else _stored(row)


def list_jobs_by_id(connection: Connection, job_ids: Sequence[str]) -> dict[str, StoredJob]:
    """Return these jobs by id."""
    rows = connection.execute(select(JOBS).where(JOBS.c.id.in_(job_ids))).mappings()
    return {job.job_id: job for job in map(_stored, rows)}


def list_jobs(
    connection: Connection, asked: JobsAsked, *, after: JobKey | None, limit: int
) -> list[StoredJob]:
    """Return up to ``limit + 1`` jobs, the newest first, from behind ``after``."""
    query = select(JOBS).order_by(JOBS.c.created_s.desc(), JOBS.c.id.desc()).limit(limit + 1)
    for column, value in (
        (JOBS.c.site_id, asked.site_id),
        (JOBS.c.kind, asked.kind),
        (JOBS.c.state, asked.state),
    ):
        if value is not None:
            query = query.where(column == value)
    if after is not None:
        query = query.where(tuple_(JOBS.c.created_s, JOBS.c.id) < after)
    return [_stored(row) for row in connection.execute(query).mappings()]


def fail_unended(
    connection: Connection, problem: dict[str, Any], ended_s: float, but: Collection[str] = ()
) -> int:
    """Fail the jobs that the end of the server cut off, ``but`` these; return how many."""
    cut_off = update(JOBS).where(JOBS.c.state.not_in(ENDED), JOBS.c.id.not_in(but))
    return connection.execute(
        cut_off.values(state="failed", problem=problem, ended_s=ended_s)
    ).rowcount


def _values(job: StoredJob) -> dict[str, Any]:
    return {
        "site_id": job.site_id,
        "kind": job.kind,
        "state": job.state,
        "progress": job.progress,
        "result": job.result,
        "problem": job.problem,
        "created_s": job.created_s,
        "ended_s": job.ended_s,
    }


def _stored(row: RowMapping) -> StoredJob:
    fields = dict(row)
    return StoredJob(job_id=fields.pop("id"), **fields)
