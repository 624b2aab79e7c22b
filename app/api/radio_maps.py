"""``/v1/radio-maps``: the versions of a site's radio map, built, compared, activated, carried."""

from typing import Annotated, Any

from fastapi import Query, Request, Response
from pydantic import BaseModel, Field

from app.api.auth import Principal, check_site
from app.api.context import ApiContext
from app.api.fix import iso_time
from app.api.jobs import Job, job_view
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Name,
    Reader,
    Reference,
    StrictModel,
    listed_site,
    registry_router,
)
from app.api.uploads import read_bounded
from app.core.fingerprint.comparison import Comparison
from app.formats.radio_map_file import MAX_FILE_BYTES
from app.services import radio_maps as radio_map_service
from app.services.errors import found
from app.services.radio_map_building import BuildOptions, Placing
from app.services.radio_map_builds import DEFAULT_NAME, BuildRequest
from app.services.writing import write
from app.storage import radio_maps
from app.storage.radio_maps import StoredRadioMap

router = registry_router("/v1/radio-maps", "radio maps")
rollback_router = registry_router("/v1/sites", "radio maps")

FILE_TYPE = "application/zip"
_BYTES = {"schema": {"type": "string", "format": "binary"}}


class RadioMap(BaseModel):
    """A radio map: how much is in it and where it came from."""

    radio_map_id: str
    site_id: str
    version: int
    name: str
    active: bool
    fingerprints: int
    transmitters: int
    created: str
    provenance: dict[str, Any] | None


class NewRadioMap(StrictModel):
    """A radio map to build of surveys; without ``surveys`` of all of the site."""

    site_id: Reference
    surveys: list[Reference] = Field(default_factory=list, max_length=1000)
    name: Name = DEFAULT_NAME
    virtual: bool = Field(True, description="Fill walkable floor that the survey missed")
    cleaning: bool = Field(True, description="One cleaned fingerprint for each reference point")
    placing: Annotated[Placing, Field(strict=False)] = Field(
        Placing.SMOOTHED, description="How scans of walks are placed between waypoints"
    )


class LevelChange(BaseModel):
    """A transmitter that is heard otherwise: after less before, over the cells of both maps."""

    key: str
    change_db: float
    cells: int


class PlaceChange(BaseModel):
    """A cell of either map, by its centre; errors are cross-validated, null where unknown."""

    floor_id: str
    x: float
    y: float
    rows_before: int
    rows_after: int
    error_before_m: float | None
    error_after_m: float | None


class MapComparison(BaseModel):
    """What changed between two radio maps; mean errors are over the cells that both have."""

    error_before_m: float | None
    error_after_m: float | None
    transmitters_gained: list[str]
    transmitters_lost: list[str]
    transmitters_changed: list[LevelChange]
    places: list[PlaceChange]


@router.get("")
async def list_radio_maps(
    principal: Reader,
    context: Context,
    paging: Paging,
    site_id: str | None = None,
    active: Annotated[bool | None, Query(description="Only the active ones, or the others")] = None,
) -> Page[RadioMap]:
    """List radio maps by id."""
    site = listed_site(principal, site_id)
    rows = await context.database.read(
        lambda c: radio_maps.list_radio_maps(
            c, site_id=site, active=active, after=paging.after, limit=paging.limit
        )
    )
    return page_of(rows, paging.limit, lambda radio_map: radio_map.radio_map_id, radio_map_view)


@router.post("", status_code=202)
async def build_radio_map(
    body: NewRadioMap, principal: Admin, context: Context, response: Response
) -> Job:
    """Build a radio map of surveys, as a job; it is not active until it is activated."""
    check_site(principal, body.site_id)
    options = BuildOptions(body.virtual, body.cleaning, body.placing)
    asked = BuildRequest(body.site_id, tuple(body.surveys), body.name, options)
    job = await context.builds.start(asked)
    response.headers["Location"] = f"/v1/jobs/{job.job_id}"
    return job_view(job, principal)


@router.post(
    "/import",
    status_code=201,
    openapi_extra={"requestBody": {"required": True, "content": {FILE_TYPE: _BYTES}}},
)
async def import_radio_map(
    principal: Admin,
    context: Context,
    request: Request,
    response: Response,
    site_id: Annotated[str, Query(description="Site that the map becomes the next version of")],
) -> RadioMap:
    """Take a radio map from a file, as exported; it is not active until it is activated."""
    check_site(principal, site_id)
    raw = await read_bounded(request, MAX_FILE_BYTES)
    content = await context.plans.run(lambda: radio_map_service.read_file(raw))
    now_s = context.clock.now_s()
    stored = await write(
        context.database, lambda c: radio_map_service.imported(c, site_id, content, now_s)
    )
    response.headers["Location"] = f"/v1/radio-maps/{stored.radio_map_id}"
    return radio_map_view(stored)


@router.get("/{radio_map_id}")
async def get_radio_map(radio_map_id: str, principal: Reader, context: Context) -> RadioMap:
    """Return what is known of one radio map."""
    return radio_map_view(await _reached(context, principal, radio_map_id))


@router.get(
    "/{radio_map_id}/export",
    response_class=Response,
    responses={200: {"description": "The file", "content": {FILE_TYPE: _BYTES}}},
)
async def export_radio_map(radio_map_id: str, principal: Reader, context: Context) -> Response:
    """Return a radio map as one file; it can be imported again, here or on another server."""
    stored = await _reached(context, principal, radio_map_id)
    raw = await context.database.read(lambda c: radio_map_service.exported(c, radio_map_id))
    name = f'attachment; filename="{stored.site_id}-v{stored.version}.zip"'
    return Response(raw, media_type=FILE_TYPE, headers={"Content-Disposition": name})


@router.get("/{radio_map_id}/compare/{other_id}")
async def compare_radio_maps(
    radio_map_id: str, other_id: str, principal: Reader, context: Context
) -> MapComparison:
    """Tell what changed from the first radio map to the second, and the error of both by place."""
    await _reached(context, principal, radio_map_id)
    await _reached(context, principal, other_id)
    pair = await context.database.read(
        lambda c: radio_map_service.load_pair(c, radio_map_id, other_id)
    )
    return _comparison(await context.plans.run(lambda: radio_map_service.compared(*pair)))


@router.post("/{radio_map_id}/activate")
async def activate_radio_map(radio_map_id: str, principal: Admin, context: Context) -> RadioMap:
    """Match with this radio map from now on; live sessions go on with it."""
    await _reached(context, principal, radio_map_id)
    stored = await write(context.database, lambda c: radio_map_service.activate(c, radio_map_id))
    await context.directory.refresh()
    return radio_map_view(stored)


@router.delete("/{radio_map_id}", status_code=204)
async def delete_radio_map(radio_map_id: str, principal: Admin, context: Context) -> None:
    """Remove a radio map, which must not be the active one."""
    await _reached(context, principal, radio_map_id)
    await write(context.database, lambda c: radio_map_service.remove(c, radio_map_id))


@rollback_router.post("/{site_id}/radio-map/rollback")
async def roll_back_radio_map(site_id: str, principal: Admin, context: Context) -> RadioMap:
    """Match with the radio map again that was active before; repeated, with earlier ones."""
    check_site(principal, site_id)
    stored = await write(context.database, lambda c: radio_map_service.roll_back(c, site_id))
    await context.directory.refresh()
    return radio_map_view(stored)


async def _reached(context: ApiContext, principal: Principal, radio_map_id: str) -> StoredRadioMap:
    stored = found(
        await context.database.read(lambda c: radio_maps.get_radio_map(c, radio_map_id)),
        "radio map",
        radio_map_id,
    )
    check_site(principal, stored.site_id)
    return stored


def _comparison(comparison: Comparison) -> MapComparison:
    return MapComparison(
        error_before_m=comparison.error_before_m,
        error_after_m=comparison.error_after_m,
        transmitters_gained=list(comparison.gained),
        transmitters_lost=list(comparison.lost),
        transmitters_changed=[
            LevelChange(key=change.key, change_db=change.change_db, cells=change.cells)
            for change in comparison.levels
        ],
        places=[
            PlaceChange(
                floor_id=place.floor_id,
                x=place.x_m,
                y=place.y_m,
                rows_before=place.rows_before,
                rows_after=place.rows_after,
                error_before_m=place.error_before_m,
                error_after_m=place.error_after_m,
            )
            for place in comparison.places
        ],
    )


def radio_map_view(radio_map: StoredRadioMap) -> RadioMap:
    """Return a radio map as it is told."""
    return RadioMap(
        radio_map_id=radio_map.radio_map_id,
        site_id=radio_map.site_id,
        version=radio_map.version,
        name=radio_map.name,
        active=radio_map.active,
        fingerprints=radio_map.fingerprints,
        transmitters=radio_map.transmitters,
        created=iso_time(radio_map.created_s),
        provenance=radio_map.provenance,
    )
