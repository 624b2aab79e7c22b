"""The features of a floor's map one by one, each under an id that stays while others change.

A feature keeps the ``id`` that its document gives it, if it can stand in a URL and no feature
before has it. Any other gets one made of its content, which is written into the document with the
first edit of a single feature.
"""

import re
from collections.abc import Container, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from itertools import chain, count
from typing import Any, TypeAlias

import msgspec
import shapely

from app.formats.floor_map import FloorMapError, parse_feature

Feature: TypeAlias = dict[str, Any]

FRAME_MARGIN_M = 1.0
"""How far a feature may reach beyond its floor: outer walls are drawn along their middle."""

FEATURE_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, slots=True)
class FloorFrame:
    """The rectangle of a floor in the site frame."""

    x0_m: float
    y0_m: float
    width_m: float
    height_m: float


def features_by_id(document: Mapping[str, Any] | None) -> dict[str, Feature]:
    """Return the features of a stored map (None: there is no map) in its order, each with its id.

    Removing or changing one of them leaves the ids of all others as they are.
    """
    features: list[Feature] = [] if document is None else list(document["features"])
    given = [_given_id(feature) for feature in features]
    taken = {name for name in given if name is not None}
    by_id: dict[str, Feature] = {}
    for feature, name in zip(features, given, strict=True):
        own = name if name is not None and name not in by_id else made_id(feature, taken)
        taken.add(own)
        by_id[own] = {**feature, "id": own}
    return by_id


def made_id(feature: Feature, taken: Container[str]) -> str:
    """Return an id made of a feature's content that is none of those ``taken``."""
    name = digest_of({key: value for key, value in feature.items() if key != "id"})[:12]
    names = chain([name], (f"{name}-{i}" for i in count(2)))
    return next(candidate for candidate in names if candidate not in taken)


def digest_of(feature: Feature) -> str:
    """Return the hash of a feature's content: its ETag."""
    return blake2b(msgspec.json.encode(feature, order="sorted"), digest_size=16).hexdigest()


def map_of_features(document: Mapping[str, Any] | None, by_id: Mapping[str, Feature]) -> Feature:
    """Return the map with these features in place of its own."""
    rest = {"type": "FeatureCollection"} if document is None else document
    return {**rest, "features": list(by_id.values())}


def check_feature(feature: Feature, frame: FloorFrame) -> None:
    """Check a feature on its own and against its floor.

    Raises
    ------
    FloorMapError
        If it is not a map's feature, has an id that cannot stand in a URL, or reaches beyond the
        floor by more than `FRAME_MARGIN_M`; its pointer starts at the feature.
    """
    if not isinstance(feature.get("id"), str) or not FEATURE_ID.fullmatch(feature["id"]):
        detail = "not 1 to 64 letters, digits, dots, dashes and underscores"
        raise FloorMapError(pointer="#/id", detail=detail)
    for x_m, y_m in shapely.get_coordinates(parse_feature(feature).geometry).tolist():
        across_m, up_m = x_m - frame.x0_m, y_m - frame.y0_m
        within = (
            -FRAME_MARGIN_M <= across_m <= frame.width_m + FRAME_MARGIN_M
            and -FRAME_MARGIN_M <= up_m <= frame.height_m + FRAME_MARGIN_M
        )
        if not within:
            detail = (
                f"[{x_m:g}, {y_m:g}] is outside of the floor: x {frame.x0_m:g} to "
                f"{frame.x0_m + frame.width_m:g} m, y {frame.y0_m:g} to "
                f"{frame.y0_m + frame.height_m:g} m"
            )
            raise FloorMapError(pointer="#/geometry/coordinates", detail=detail)


def _given_id(feature: Feature) -> str | None:
    given = feature.get("id")
    text = str(given) if isinstance(given, str | int) and not isinstance(given, bool) else ""
    return text if FEATURE_ID.fullmatch(text) else None
