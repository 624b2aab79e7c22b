"""``/v1/floors``: levels of a building in their site's frame, with plan image and map."""

from dataclasses import replace
from typing import Annotated, Any

from fastapi import Request, Response
from fastapi.responses import JSONResponse
from pydantic import Field

from app.api.auth import Principal, check_site
from app.api.conditional import (
    NOT_MODIFIED,
    MergePatch,
    Seen,
    etag_of,
    is_held,
    not_modified,
    patch_schema,
    patched,
)
from app.api.context import ApiContext
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Identifier,
    Metres,
    Name,
    Reader,
    Reference,
    StrictModel,
    Text,
    created,
    listed_site,
    registry_router,
    tagged,
)
from app.api.uploads import PLAN_TYPES, read_json_object, read_plan_image
from app.services import site as site_service
from app.services.errors import found
from app.storage import floors
from app.storage.floors import StoredFloor

router = registry_router("/v1/floors", "floors")

MAP_BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
}

PLAN_BYTES = {"schema": {"type": "string", "format": "binary"}}
PLAN_BODY = {"requestBody": {"required": True, "content": dict.fromkeys(PLAN_TYPES, PLAN_BYTES)}}

MAX_MAP_BYTES = 32 << 20

Size = Annotated[float, Field(gt=0, le=10_000, description="Metres")]


class FloorFields(StrictModel):
    """What an admin may change of a floor; ``x0``, ``y0`` is the lower left corner of its plan."""

    name: Name
    building: Text = ""
    ordinal: Annotated[int, Field(ge=-100, le=500, description="0 is the ground floor")]
    x0: Metres = 0.0
    y0: Metres = 0.0
    width: Size
    height: Size


class NewFloor(FloorFields):
    """A floor to add."""

    floor_id: Identifier
    site_id: Reference


class Floor(FloorFields):
    """A floor; ``plan`` and ``map`` tell where its picture and its map are, null without."""

    floor_id: str
    site_id: str
    plan: str | None
    map: str | None


@router.get("")
async def list_floors(
    principal: Reader,
    context: Context,
    paging: Paging,
    site_id: str | None = None,
) -> Page[Floor]:
    """List floors by id."""
    site = listed_site(principal, site_id)
    rows = await context.database.read(
        lambda c: floors.list_floors(c, site_id=site, after=paging.after, limit=paging.limit)
    )
    return page_of(rows, paging.limit, lambda floor: floor.floor_id, _view)


@router.post("", status_code=201)
async def create_floor(
    body: NewFloor, principal: Admin, context: Context, response: Response
) -> Floor:
    """Add a floor to a site."""
    check_site(principal, body.site_id)
    stored = await site_service.create_floor(
        context.database,
        StoredFloor(floor_id=body.floor_id, site_id=body.site_id, **_columns(body)),
    )
    await context.directory.refresh()
    return created(response, f"/v1/floors/{stored.floor_id}", stored.row_version, _view(stored))


@router.get("/{floor_id}", response_model=Floor, responses=NOT_MODIFIED)
async def get_floor(
    floor_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Floor | Response:
    """Return one floor."""
    stored = await floor_in_scope(context, principal, floor_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(stored))


@router.put("/{floor_id}")
async def replace_floor(
    floor_id: str,
    body: FloorFields,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Floor:
    """Replace names and frame of a floor."""
    await floor_in_scope(context, principal, floor_id)
    stored = await site_service.edit_floor(
        context.database, floor_id, seen, lambda floor: replace(floor, **_columns(body))
    )
    await context.directory.refresh()
    return tagged(response, stored.row_version, _view(stored))


@router.patch("/{floor_id}", openapi_extra=patch_schema(FloorFields))
async def patch_floor(
    floor_id: str,
    patch: MergePatch,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Floor:
    """Change some fields of a floor (merge-patch)."""
    await floor_in_scope(context, principal, floor_id)

    def edit(floor: StoredFloor) -> StoredFloor:
        return replace(floor, **_columns(patched(FloorFields(**_fields(floor)), patch)))

    stored = await site_service.edit_floor(context.database, floor_id, seen, edit)
    await context.directory.refresh()
    return tagged(response, stored.row_version, _view(stored))


@router.delete("/{floor_id}", status_code=204)
async def delete_floor(floor_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Remove a floor that has no beacons any more; recorded tracks stay."""
    await floor_in_scope(context, principal, floor_id)
    await site_service.delete_floor(context.database, floor_id, seen)
    await context.directory.refresh()


@router.get("/{floor_id}/plan", response_class=Response, responses=NOT_MODIFIED)
async def get_plan(
    floor_id: str, principal: Reader, context: Context, request: Request
) -> Response:
    """Return the plan image; its ETag is a hash of its bytes."""
    await floor_in_scope(context, principal, floor_id)
    plan = found(
        await context.database.read(lambda c: floors.get_plan(c, floor_id)),
        "plan of floor",
        floor_id,
    )
    if is_held(request, plan.digest):
        return not_modified(plan.digest)
    headers = {
        "ETag": etag_of(plan.digest),
        "Cache-Control": "private, no-cache",
        # A drawing is shown, never run: SVG may carry scripts.
        "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; sandbox",
        "X-Content-Type-Options": "nosniff",
    }
    return Response(plan.image, media_type=plan.media_type, headers=headers)


@router.put("/{floor_id}/plan", status_code=204, openapi_extra=PLAN_BODY)
async def replace_plan(
    floor_id: str, principal: Admin, context: Context, seen: Seen, request: Request
) -> Response:
    """Replace the plan image (PNG, JPEG or SVG as the body); no coordinate moves."""
    await floor_in_scope(context, principal, floor_id)
    plan = await read_plan_image(request)
    await site_service.replace_plan(context.database, floor_id, seen, plan)
    return Response(status_code=204, headers={"ETag": etag_of(plan.digest)})


@router.delete("/{floor_id}/plan", status_code=204)
async def delete_plan(floor_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Remove the plan image."""
    await floor_in_scope(context, principal, floor_id)
    await site_service.replace_plan(context.database, floor_id, seen, None)


@router.get("/{floor_id}/map", response_class=JSONResponse, responses=NOT_MODIFIED)
async def get_map(floor_id: str, principal: Reader, context: Context, request: Request) -> Response:
    """Return walls, walkable outlines and obstacles, in metres of the site frame."""
    stored = await floor_in_scope(context, principal, floor_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    document = found(
        await context.database.read(lambda c: floors.get_map(c, floor_id)),
        "map of floor",
        floor_id,
    )
    return JSONResponse(document, headers={"ETag": etag_of(stored.row_version)})


@router.put("/{floor_id}/map", status_code=204, openapi_extra=MAP_BODY)
async def replace_map(
    floor_id: str, principal: Admin, context: Context, seen: Seen, request: Request
) -> None:
    """Replace the map: a FeatureCollection with coordinates in metres of the site frame.

    `properties.kind` of a feature is `walkable`, `obstacle` (both polygons) or `wall` (lines).
    """
    await floor_in_scope(context, principal, floor_id)
    document = await read_json_object(request, MAX_MAP_BYTES)
    await site_service.replace_map(context.database, floor_id, seen, document)
    await context.directory.refresh()


@router.delete("/{floor_id}/map", status_code=204)
async def delete_map(floor_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Remove the map."""
    await floor_in_scope(context, principal, floor_id)
    await site_service.replace_map(context.database, floor_id, seen, None)
    await context.directory.refresh()


async def floor_in_scope(context: ApiContext, principal: Principal, floor_id: str) -> StoredFloor:
    """Return a floor that the token may see."""
    stored = found(
        await context.database.read(lambda c: floors.get_floor(c, floor_id)), "floor", floor_id
    )
    check_site(principal, stored.site_id)
    return stored


def _fields(floor: StoredFloor) -> dict[str, Any]:
    return {
        "name": floor.name,
        "building": floor.building,
        "ordinal": floor.ordinal,
        "x0": floor.x0_m,
        "y0": floor.y0_m,
        "width": floor.width_m,
        "height": floor.height_m,
    }


def _columns(fields: FloorFields) -> dict[str, Any]:
    return {
        "name": fields.name,
        "building": fields.building,
        "ordinal": fields.ordinal,
        "x0_m": fields.x0,
        "y0_m": fields.y0,
        "width_m": fields.width,
        "height_m": fields.height,
    }


def _view(floor: StoredFloor) -> Floor:
    path = f"/v1/floors/{floor.floor_id}"
    return Floor(
        **_fields(floor),
        floor_id=floor.floor_id,
        site_id=floor.site_id,
        plan=f"{path}/plan" if floor.plan_media_type else None,
        map=f"{path}/map" if floor.has_map else None,
    )
