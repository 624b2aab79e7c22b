"""The map of a floor: walls, walkable outlines and obstacles, one FeatureCollection in site metres.

It has the shape of GeoJSON, but its coordinates are x, y in the site frame, so it is plain JSON and
not an RFC 7946 document. ``properties.kind`` says what a feature is: ``walkable`` or ``obstacle``
(Polygon, MultiPolygon) or ``wall`` (LineString, MultiLineString). What a wall takes from a level
that passes it is its ``attenuation_db`` or, without that, what its ``material`` usually takes.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
import shapely
from shapely.errors import GEOSException
from shapely.geometry import mapping, shape
from shapely.geometry.base import BaseGeometry

from app.core.geometry import Walkable
from app.core.site import Wall
from app.formats.walkable import WalkableError, rasterise_walkable

MAX_COORDINATES = 200_000
"""A shopping mall's floor has a few thousand; more is a drawing, not a map."""

MAX_COORDINATE_M = 100_000.0

DEFAULT_ATTENUATION_DB = 4.0
"""Plasterboard to light brick at 2.4 GHz."""

MATERIALS_DB: Mapping[str, float] = MappingProxyType(
    {
        "glass": 2.0,
        "wood": 3.0,
        "plasterboard": 3.0,
        "brick": 6.0,
        "masonry": 9.0,
        "concrete": 12.0,
        "reinforced_concrete": 18.0,
        "metal": 26.0,
    }
)
"""What a wall of a material usually takes from a level at 2.4 GHz, dB.

Working figures of the order that measurements give (COST 231, final report 1999, ch. 4.7: light
walls 3.4, heavy ones 6.9 dB at 1.8 GHz; Stone, NISTIR 6055, 1997, for masonry and concrete). Two
walls of one material easily differ by a few dB: who has measured his own gives that.
"""

_AREAS = frozenset({"Polygon", "MultiPolygon"})
_LINES = frozenset({"LineString", "MultiLineString"})
_KINDS = {"walkable": _AREAS, "obstacle": _AREAS, "wall": _LINES}


class FloorMapError(ValueError):
    """The document is not a floor's map; ``pointer`` is the JSON pointer of what is wrong."""

    def __init__(self, *, pointer: str, detail: str) -> None:
        super().__init__(detail)
        self.pointer = pointer
        self.detail = detail


@dataclass(frozen=True, slots=True)
class FloorMap:
    """A map's parts: outlines in site metres, and the walls that the engine takes as they are."""

    walkable: tuple[BaseGeometry, ...] = ()
    obstacles: tuple[BaseGeometry, ...] = ()
    walls: tuple[Wall, ...] = ()

    def raster(self, cell_m: float = 0.5) -> Walkable | None:
        """Return the walkable raster, None if the map has no walkable outline.

        Raises
        ------
        FloorMapError
            If the obstacles leave nothing to walk on, or the outlines are too large.
        """
        if not self.walkable:
            return None
        try:
            return rasterise_walkable(self.walkable, self.obstacles, cell_m)
        except WalkableError as error:
            raise FloorMapError(pointer="#/features", detail=str(error)) from error


@dataclass(frozen=True, slots=True)
class MapFeature:
    """One part of a map; a wall has at least one stretch."""

    kind: str
    geometry: BaseGeometry
    walls: tuple[Wall, ...] = ()


def parse_floor_map(
    document: Mapping[str, Any], materials_db: Mapping[str, float] = MATERIALS_DB
) -> FloorMap:
    """Return the parts of a map; ``materials_db`` tells what walls of a material take, dB.

    Raises
    ------
    FloorMapError
        If a feature is not of a known kind or its geometry is not valid.
    """
    by_kind: dict[str, list[BaseGeometry]] = {kind: [] for kind in _KINDS}
    walls: list[Wall] = []
    coordinates = 0
    for i, document_of_feature in enumerate(_features(document)):
        feature = parse_feature(document_of_feature, f"#/features/{i}", materials_db)
        coordinates += int(shapely.count_coordinates(feature.geometry))
        if coordinates > MAX_COORDINATES:
            detail = f"more than {MAX_COORDINATES} coordinates"
            raise FloorMapError(pointer="#/features", detail=detail)
        by_kind[feature.kind].append(feature.geometry)
        walls.extend(feature.walls)
    return FloorMap(tuple(by_kind["walkable"]), tuple(by_kind["obstacle"]), tuple(walls))


def parse_feature(
    document: object, pointer: str = "#", materials_db: Mapping[str, float] = MATERIALS_DB
) -> MapFeature:
    """Return one feature of a map; ``pointer`` tells where in its document it is.

    Raises
    ------
    FloorMapError
        If it is not of a known kind or its geometry is not valid.
    """
    kind, geometry, properties = _feature(pointer, document)
    if kind != "wall":
        return MapFeature(kind, geometry)
    attenuation_db = _attenuation_db(f"{pointer}/properties", properties, materials_db)
    return MapFeature(kind, geometry, tuple(_walls(geometry, attenuation_db)))


def floor_map_document(
    walkable: Iterable[BaseGeometry] = (),
    obstacles: Iterable[BaseGeometry] = (),
    walls: Iterable[BaseGeometry] = (),
) -> dict[str, Any]:
    """Return the map of geometries in site metres, as `parse_floor_map` takes it."""
    kinds = (("walkable", walkable), ("obstacle", obstacles), ("wall", walls))
    features = [
        {"type": "Feature", "properties": {"kind": kind}, "geometry": mapping(geometry)}
        for kind, geometries in kinds
        for geometry in geometries
    ]
    return {"type": "FeatureCollection", "features": features}


def _features(document: Mapping[str, Any]) -> Sequence[Any]:
    features = document.get("features")
    if document.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise FloorMapError(pointer="#", detail="not a FeatureCollection")
    return features


def _feature(pointer: str, feature: object) -> tuple[str, BaseGeometry, Mapping[str, Any]]:
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise FloorMapError(pointer=pointer, detail="not a Feature")
    properties = feature.get("properties")
    kind = properties.get("kind") if isinstance(properties, dict) else None
    if not isinstance(properties, dict) or kind not in _KINDS:
        raise FloorMapError(
            pointer=f"{pointer}/properties/kind", detail=f"not one of {', '.join(_KINDS)}"
        )
    return kind, _geometry(f"{pointer}/geometry", feature.get("geometry"), _KINDS[kind]), properties


def _geometry(pointer: str, document: object, allowed: frozenset[str]) -> BaseGeometry:
    if not isinstance(document, dict) or document.get("type") not in allowed:
        raise FloorMapError(
            pointer=f"{pointer}/type", detail=f"not one of {', '.join(sorted(allowed))}"
        )
    try:
        geometry = shape(document)
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, GEOSException) as error:
        raise FloorMapError(
            pointer=f"{pointer}/coordinates", detail="not coordinates of its type"
        ) from error
    xy_m = shapely.get_coordinates(geometry)
    if geometry.is_empty or not (np.abs(xy_m) <= MAX_COORDINATE_M).all():
        detail = f"empty, or not within {MAX_COORDINATE_M:.0f} m"
        raise FloorMapError(pointer=f"{pointer}/coordinates", detail=detail)
    if not geometry.is_valid:
        detail = f"not valid: {shapely.is_valid_reason(geometry)}"
        raise FloorMapError(pointer=f"{pointer}/coordinates", detail=detail)
    return geometry


def _attenuation_db(
    pointer: str, properties: Mapping[str, Any], materials_db: Mapping[str, float]
) -> float:
    if "attenuation_db" not in properties and "material" in properties:
        material = properties["material"]
        if not isinstance(material, str) or material not in materials_db:
            detail = f"not one of {', '.join(materials_db)}"
            raise FloorMapError(pointer=f"{pointer}/material", detail=detail)
        return materials_db[material]
    value = properties.get("attenuation_db", DEFAULT_ATTENUATION_DB)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 100:
        raise FloorMapError(
            pointer=f"{pointer}/attenuation_db", detail="not a number of 0 to 100 dB"
        )
    return float(value)


def _walls(geometry: BaseGeometry, attenuation_db: float) -> Iterable[Wall]:
    for line in shapely.get_parts(geometry):
        xy_m = shapely.get_coordinates(line).tolist()
        for (x0_m, y0_m), (x1_m, y1_m) in pairwise(xy_m):
            yield Wall(x0_m, y0_m, x1_m, y1_m, attenuation_db)
