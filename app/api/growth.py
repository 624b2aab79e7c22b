"""``/v1/sites/{id}/growth``: what the radio map would become by the sessions kept aside."""

from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, Field

from app.api.auth import check_site
from app.api.fix import iso_time
from app.api.jobs import Job, job_view
from app.api.radio_maps import RadioMap, radio_map_view
from app.api.resource import Admin, Context, registry_router
from app.services.growth import Look

router = registry_router("/v1/sites", "radio maps")


class GrownPlace(BaseModel):
    """A cell of 5 m by its centre, and how many fingerprints it would gain."""

    floor_id: str
    x: float
    y: float
    fingerprints: int


class GrowthEffect(BaseModel):
    """Surveyed scans, each placed alone and without its own walk, by either map."""

    scans: int
    before_m: float | None = Field(description="Their mean error as the map is")
    after_m: float | None = Field(description="Their mean error if you accepted")


class GrowthLook(BaseModel):
    """What the sessions kept aside would make of the radio map."""

    looked_at: str
    sessions: int = Field(description="Those that the map knows well enough to join")
    fingerprints: int
    places: list[GrownPlace]
    effect: GrowthEffect | None = Field(description="null: no session would join")


class Growth(BaseModel):
    """What is kept aside, and the newest look at it."""

    waiting: int = Field(description="Sessions kept aside, undecided")
    look: GrowthLook | None = Field(
        description="null: nobody has looked since the site was changed or the server started"
    )


@router.get("/{site_id}/growth")
async def get_growth(site_id: str, principal: Admin, context: Context) -> Growth:
    """Return how many sessions are kept aside, and what the newest look at them has shown."""
    check_site(principal, site_id)
    waiting = await context.growth.waiting(site_id)
    look = context.growth.latest(site_id)
    return Growth(waiting=waiting, look=None if look is None else _view(look))


@router.post("/{site_id}/growth", status_code=202)
async def look_at_growth(
    site_id: str, principal: Admin, context: Context, response: Response
) -> Job:
    """Look, as a job, at what would change if you accepted.

    The job's result is what `GET` then has as `look`. Nothing of it is matched with before you
    accept.
    """
    check_site(principal, site_id)
    job = await context.growth.start(site_id)
    response.headers["Location"] = f"/v1/jobs/{job.job_id}"
    return job_view(job, principal)


@router.post("/{site_id}/growth/accept", status_code=201)
async def accept_growth(
    site_id: str,
    principal: Admin,
    context: Context,
    response: Response,
    activate: Annotated[bool, Query(description="Make the new version the active one")] = True,
) -> RadioMap:
    """Make a new version of the radio map with the sessions that the newest look found to join.

    It is refused (409) if nobody has looked, or what was looked at has changed. The version before
    stays as it is. Sessions that did not join stay aside.
    """
    check_site(principal, site_id)
    stored = await context.growth.accept(site_id, context.clock.now_s(), activate=activate)
    response.headers["Location"] = f"/v1/radio-maps/{stored.radio_map_id}"
    return radio_map_view(stored)


@router.delete("/{site_id}/growth", status_code=204)
async def discard_growth(site_id: str, principal: Admin, context: Context) -> None:
    """Forget all sessions kept aside; they are not taken again."""
    check_site(principal, site_id)
    await context.growth.discard(site_id, context.clock.now_s())


def _view(look: Look) -> GrowthLook:
    return GrowthLook.model_validate({**look.document(), "looked_at": iso_time(look.looked_s)})
