"""``/v1/sites/{id}/growth``: what the radio map would become by the sessions kept aside."""

from typing import Annotated

from fastapi import Query, Response
from pydantic import BaseModel, Field

from app.api.auth import check_site
from app.api.radio_maps import RadioMap, radio_map_view
from app.api.resource import Admin, Context, registry_router

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


class Growth(BaseModel):
    """What the sessions kept aside would make of the radio map."""

    waiting: int = Field(description="Sessions kept aside, undecided")
    sessions: int = Field(description="Those of them that the map knows well enough to join")
    fingerprints: int
    places: list[GrownPlace]
    effect: GrowthEffect | None = Field(description="null: no session would join")


@router.get("/{site_id}/growth")
async def get_growth(site_id: str, principal: Admin, context: Context) -> Growth:
    """Look at what would change; the first look at new sessions may take a minute.

    Nothing of it is matched with before you accept.
    """
    check_site(principal, site_id)
    seen = await context.growth.look(site_id)
    places = [
        GrownPlace(floor_id=p.floor_id, x=p.x_m, y=p.y_m, fingerprints=p.fingerprints)
        for p in seen.places
    ]
    effect = seen.effect
    return Growth(
        waiting=seen.waiting,
        sessions=seen.sessions,
        fingerprints=seen.fingerprints,
        places=places,
        effect=None
        if effect is None
        else GrowthEffect(scans=effect.scans, before_m=effect.before_m, after_m=effect.after_m),
    )


@router.post("/{site_id}/growth/accept", status_code=201)
async def accept_growth(
    site_id: str,
    principal: Admin,
    context: Context,
    response: Response,
    activate: Annotated[bool, Query(description="Make the new version the active one")] = True,
) -> RadioMap:
    """Make a new version of the radio map with the sessions that would join.

    The version before stays as it is. Sessions that did not join stay aside.
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
