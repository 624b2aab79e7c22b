"""``/v1/jobs``: long work, how far it is, and what came of it."""

from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import BaseModel

from app.api.auth import check_site
from app.api.fix import iso_time
from app.api.paging import Page, Paging, newest_first_after, newest_first_cursor, page_of
from app.api.resource import Context, Reader, listed_site, registry_router
from app.services.errors import found
from app.storage.jobs import JobsAsked, StoredJob

router = registry_router("/v1/jobs", "jobs")

JobState = Literal["receiving", "waiting", "running", "done", "failed"]


class Job(BaseModel):
    """Long work; `progress` grows while it runs, then there is a `result` or a `problem`."""

    job_id: str
    site_id: str
    kind: str
    state: str
    progress: dict[str, int]
    result: dict[str, Any] | None
    problem: dict[str, Any] | None
    created: str
    ended: str | None


def job_view(job: StoredJob) -> Job:
    """Return a job as users see it."""
    return Job(
        job_id=job.job_id,
        site_id=job.site_id,
        kind=job.kind,
        state=job.state,
        progress=job.progress,
        result=job.result,
        problem=job.problem,
        created=iso_time(job.created_s),
        ended=None if job.ended_s is None else iso_time(job.ended_s),
    )


@router.get("")
async def list_jobs(
    principal: Reader,
    context: Context,
    paging: Paging,
    site_id: str | None = None,
    kind: Annotated[str | None, Query(description="As jobs tell it: `survey import`")] = None,
    state: JobState | None = None,
) -> Page[Job]:
    """List jobs, the newest first."""
    after = newest_first_after(paging)
    wanted = JobsAsked(listed_site(principal, site_id), kind, state)
    rows = await context.jobs.page(wanted, after=after, limit=paging.limit)
    return page_of(rows, paging.limit, _key, job_view)


def _key(job: StoredJob) -> str:
    return newest_first_cursor(job.created_s, job.job_id)


@router.get("/{job_id}")
async def get_job(job_id: str, principal: Reader, context: Context) -> Job:
    """Return how a job stands."""
    job = found(await context.jobs.get(job_id), "job", job_id)
    check_site(principal, job.site_id)
    return job_view(job)
