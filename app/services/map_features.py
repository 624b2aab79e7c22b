"""Edits of a single wall, walkable outline or obstacle of a floor's map."""

from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection

from app.formats.floor_map import FloorMapError
from app.formats.map_features import (
    Feature,
    FloorFrame,
    check_feature,
    digest_of,
    features_by_id,
    made_id,
    map_of_features,
)
from app.services.errors import AppError, ErrorCode, FieldError, found, invalid_field
from app.services.site import store_map
from app.services.writing import SeenVersions, check_seen
from app.storage import floors
from app.storage.database import Database
from app.storage.floors import StoredFloor

_TRIES = 5
"""Edits of other features of the map that may come between before the sender is told."""


async def read_features(database: Database, floor_id: str) -> dict[str, Feature]:
    """Return the features of a floor's map by id; none if it has no map."""
    return features_by_id(await database.read(lambda c: floors.get_map(c, floor_id)))


async def add_feature(database: Database, floor_id: str, feature: Feature) -> Feature:
    """Add a feature to a floor's map, under an id of its own if it has none; return it."""
    added: Feature = {}

    def edit(features: dict[str, Feature], frame: FloorFrame) -> None:
        nonlocal added
        named = feature.get("id") is not None
        added = feature if named else {**feature, "id": made_id(feature, features)}
        _checked(added, frame)
        if added["id"] in features:
            detail = f"a feature {added['id']!r} is there already"
            raise AppError(ErrorCode.CONFLICT, detail)
        features[added["id"]] = added

    await _edit(database, floor_id, edit)
    return added


async def change_feature(
    database: Database,
    floor_id: str,
    feature_id: str,
    seen: SeenVersions,
    change: Callable[[Feature], Any],
) -> Feature:
    """Change a feature of a floor's map; ``change`` gets it as stored. Return it as changed."""
    changed: Feature = {}

    def edit(features: dict[str, Feature], frame: FloorFrame) -> None:
        nonlocal changed
        changed = change(_seen(features, feature_id, seen))
        if changed.get("id") != feature_id:
            raise invalid_field(pointer="#/id", detail="a feature keeps its id")
        _checked(changed, frame)
        features[feature_id] = changed

    await _edit(database, floor_id, edit)
    return changed


async def remove_feature(
    database: Database, floor_id: str, feature_id: str, seen: SeenVersions
) -> None:
    """Remove a feature from a floor's map."""

    def edit(features: dict[str, Feature], frame: FloorFrame) -> None:
        _ = frame
        _seen(features, feature_id, seen)
        del features[feature_id]

    await _edit(database, floor_id, edit)


async def _edit(
    database: Database, floor_id: str, edit: Callable[[dict[str, Feature], FloorFrame], None]
) -> None:
    """Store a floor's map with its features edited, on whatever state of the others there is."""
    for _ in range(_TRIES):
        floor, document = await database.read(lambda c: _stored_map(c, floor_id))
        features = features_by_id(document)
        edit(features, FloorFrame(floor.x0_m, floor.y0_m, floor.width_m, floor.height_m))
        seen = frozenset({str(floor.row_version)})
        try:
            await store_map(database, floor_id, seen, map_of_features(document, features))
        except FloorMapError as error:
            # Each feature is right by itself: it is the map that they would make together.
            raise _refused(FieldError("#", error.detail)) from error
        except AppError as error:
            if error.code is not ErrorCode.ETAG_MISMATCH:
                raise
        else:
            return
    detail = "the map is changed all the time; come back later"
    raise AppError(ErrorCode.UNAVAILABLE, detail, retry_after_s=1)


def _stored_map(connection: Connection, floor_id: str) -> tuple[StoredFloor, dict[str, Any] | None]:
    # In this order: a map that is newer than its version is noticed when it is stored.
    floor = found(floors.get_floor(connection, floor_id), "floor", floor_id)
    return floor, floors.get_map(connection, floor_id)


def _seen(features: dict[str, Feature], feature_id: str, seen: SeenVersions) -> Feature:
    feature = found(features.get(feature_id), "feature", feature_id)
    check_seen(seen, digest_of(feature))
    return feature


def _checked(feature: Feature, frame: FloorFrame) -> None:
    try:
        check_feature(feature, frame)
    except FloorMapError as error:
        raise _refused(FieldError(error.pointer, error.detail)) from error


def _refused(error: FieldError) -> AppError:
    detail = "the map cannot have this feature"
    return AppError(ErrorCode.INVALID_FIELD, detail, errors=(error,))
