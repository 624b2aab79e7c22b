"""``/v1/floors/{id}/map/features``: walls, walkable outlines and obstacles one by one."""

from itertools import islice
from typing import Annotated, Any, Literal

from fastapi import Depends, Request, Response
from pydantic import BaseModel, ConfigDict

from app.api.conditional import (
    NOT_MODIFIED,
    PATCH_TYPES,
    MergePatch,
    Seen,
    apply_merge_patch,
    is_held,
    not_modified,
)
from app.api.floors import floor_in_scope
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    MAX_JSON_BYTES,
    Admin,
    Context,
    Reader,
    created,
    registry_router,
    tagged,
)
from app.api.uploads import read_json_object
from app.formats.map_features import Feature, digest_of
from app.services import map_features
from app.services.errors import found

router = registry_router("/v1/floors/{floor_id}/map/features", "floors")

Kind = Literal["walkable", "obstacle", "wall"]


class MapFeature(BaseModel):
    """A feature of a map: its `id` is its name in the URL, `properties.kind` says what it is."""

    model_config = ConfigDict(extra="allow")

    type: Literal["Feature"]
    id: str
    properties: dict[str, Any]
    geometry: dict[str, Any]


_SCHEMA = MapFeature.model_json_schema()


def _body(media_type: str, *required: str) -> dict[str, Any]:
    schema = {**_SCHEMA, "required": list(required)}
    return {"requestBody": {"required": True, "content": {media_type: {"schema": schema}}}}


async def _read_floor(floor_id: str, principal: Reader, context: Context) -> str:
    await floor_in_scope(context, principal, floor_id)
    return floor_id


async def _edited_floor(floor_id: str, principal: Admin, context: Context) -> str:
    await floor_in_scope(context, principal, floor_id)
    return floor_id


ReadFloor = Annotated[str, Depends(_read_floor)]
EditedFloor = Annotated[str, Depends(_edited_floor)]


@router.get("")
async def list_features(
    floor_id: ReadFloor, context: Context, paging: Paging, kind: Kind | None = None
) -> Page[MapFeature]:
    """List the features of a floor's map by id, all or those of one kind."""
    features = await map_features.read_features(context.database, floor_id)
    rows = (
        features[feature_id]
        for feature_id in sorted(features)
        if feature_id > (paging.after or "")
        and kind in {None, features[feature_id]["properties"]["kind"]}
    )
    page = list(islice(rows, paging.limit + 1))
    return page_of(page, paging.limit, lambda feature: str(feature["id"]), _view)


@router.post("", status_code=201, openapi_extra=_body("application/json", "properties", "geometry"))
async def create_feature(
    floor_id: EditedFloor, context: Context, request: Request, response: Response
) -> MapFeature:
    """Add a wall, walkable outline or obstacle; a floor without a map gets one.

    Coordinates are metres of the site frame; `id` may be left out. Live sessions go on with it.
    """
    body = {"type": "Feature", **await read_json_object(request, MAX_JSON_BYTES)}
    feature = await map_features.add_feature(context.database, floor_id, body)
    await context.directory.refresh()
    location = f"/v1/floors/{floor_id}/map/features/{feature['id']}"
    return created(response, location, digest_of(feature), _view(feature))


@router.get("/{feature_id}", response_model=MapFeature, responses=NOT_MODIFIED)
async def get_feature(
    floor_id: ReadFloor,
    feature_id: str,
    context: Context,
    request: Request,
    response: Response,
) -> MapFeature | Response:
    """Return one feature of a floor's map; its ETag is a hash of its content."""
    features = await map_features.read_features(context.database, floor_id)
    feature = found(features.get(feature_id), "feature", feature_id)
    digest = digest_of(feature)
    if is_held(request, digest):
        return not_modified(digest)
    return tagged(response, digest, _view(feature))


@router.patch("/{feature_id}", openapi_extra=_body(PATCH_TYPES[0]))
async def patch_feature(
    floor_id: EditedFloor,
    feature_id: str,
    patch: MergePatch,
    context: Context,
    seen: Seen,
    response: Response,
) -> MapFeature:
    """Change a feature (merge-patch): its place, its material, its kind.

    Other features may be edited at the same time: the ETag is of this one alone.
    """
    feature = await map_features.change_feature(
        context.database,
        floor_id,
        feature_id,
        seen,
        lambda stored: apply_merge_patch(stored, patch),
    )
    await context.directory.refresh()
    return tagged(response, digest_of(feature), _view(feature))


@router.delete("/{feature_id}", status_code=204)
async def delete_feature(
    floor_id: EditedFloor, feature_id: str, context: Context, seen: Seen
) -> None:
    """Remove a feature from a floor's map."""
    await map_features.remove_feature(context.database, floor_id, feature_id, seen)
    await context.directory.refresh()


def _view(feature: Feature) -> MapFeature:
    return MapFeature(**feature)
