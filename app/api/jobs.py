"""``/v1/jobs``: long work, how far it is, and what came of it."""

from typing import Annotated, Any, Literal

from fastapi import Query
from pydantic import BaseModel, Field

from app.api.auth import Principal, Role, check_site
from app.api.fix import iso_time
from app.api.paging import Page, Paging, newest_first_after, newest_first_cursor, page_of
from app.api.resource import Context, Reader, listed_site, registry_router
from app.services import growth
from app.services.errors import found
from app.storage.jobs import JobsAsked, StoredJob

router = registry_router("/v1/jobs", "jobs")

# Of kinds that tell what else only these may ask for; other results are for every reader.
RESULT_FOR = {growth.KIND: frozenset({Role.ADMIN})}

JobState = Literal["receiving", "waiting", "running", "done", "failed"]


class Job(BaseModel):
    """Long work; `progress` grows while it runs, then there is a `result` or a `problem`."""

    job_id: str
    site_id: str
    kind: str
    state: str
    progress: dict[str, int]
    result: dict[str, Any] | None = Field(
        description="null before it is done, and where the token may not ask for what it tells:"
        f" that of a `{growth.KIND}` is for admins"
    )
    problem: dict[str, Any] | None
    created: str
    ended: str | None


def job_view(job: StoredJob, principal: Principal) -> Job:
    """Return a job as the bearer of a token sees it."""
    may_read_result = principal.role in RESULT_FOR.get(job.kind, Role)
    return Job(
        job_id=job.job_id,
        site_id=job.site_id,
        kind=job.kind,
        state=job.state,
        progress=job.progress,
        result=job.result if may_read_result else None,
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
    return page_of(rows, paging.limit, _key, lambda job: job_view(job, principal))


def _key(job: StoredJob) -> str:
    return newest_first_cursor(job.created_s, job.job_id)


@router.get("/{job_id}")
async def get_job(job_id: str, principal: Reader, context: Context) -> Job:
    """Return how a job stands."""
    job = found(await context.jobs.get(job_id), "job", job_id)
    check_site(principal, job.site_id)
    return job_view(job, principal)
