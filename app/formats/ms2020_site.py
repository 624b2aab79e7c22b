"""A building folder of the Microsoft Indoor Location Competition 2.0: its floors in one frame.

Each folder inside is a floor: ``floor_info.json`` (size of the plan in metres), ``floor_image.png``
(stretched over that size), ``geojson_map.json`` (longitude and latitude; the first feature is the
floor's outline, the others are shops and rooms) and the traces walked there.

The plan covers exactly the bounding box of the outline. So box and size give each floor metres per
degree, and the boxes' south-west corners give the floors' offsets in one building frame: metres,
origin at the south-west corner of all boxes, x east, y north.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import shapely
from shapely.geometry import LineString, shape
from shapely.geometry.base import BaseGeometry

from app.core.georeference import ControlPoint
from app.core.types import FloatArray
from app.formats.floor_map import floor_map_document
from app.formats.ms2020 import trace_paths

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

LonLatBox: TypeAlias = tuple[float, float, float, float]


class BuildingFolderError(ValueError):
    """The folder is not a building of this format; the message says which file and why."""


@dataclass(frozen=True, slots=True)
class FloorFolder:
    """One floor as its folder tells it, placed in the building frame.

    Attributes
    ----------
    ordinal
        0 for F1, the ground floor; 1 for F2; -1 for B1.
    map_document
        Walkable outline, obstacles and walls, as `floor_map.parse_floor_map` takes it.
    traces
        Files of the walks on this floor.
    """

    name: str
    ordinal: int
    x0_m: float
    y0_m: float
    width_m: float
    height_m: float
    plan_png: bytes
    map_document: dict[str, Any]
    traces: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class BuildingFolder:
    """The floors from the lowest to the highest, and where the frame lies on the globe."""

    name: str
    floors: tuple[FloorFolder, ...]
    control_points: tuple[ControlPoint, ...]


@dataclass(frozen=True, slots=True)
class _Drawing:
    folder: Path
    size_m: tuple[float, float]
    box: LonLatBox
    storey_number: int
    outline: BaseGeometry
    rooms: tuple[BaseGeometry, ...]

    @property
    def m_per_deg(self) -> tuple[float, float]:
        west, south, east, north = self.box
        return self.size_m[0] / (east - west), self.size_m[1] / (north - south)


def read_building(folder: Path) -> BuildingFolder:
    """Read all floors of a building folder.

    Raises
    ------
    BuildingFolderError
        If there is no floor in it, or a floor lacks a file or holds one that makes no sense.
    """
    if not folder.is_dir():
        msg = f"{folder} is not a folder"
        raise BuildingFolderError(msg)
    inside = (path for path in sorted(folder.iterdir()) if (path / "floor_info.json").exists())
    drawings = sorted((_drawing(path) for path in inside), key=lambda d: d.storey_number)
    if not drawings:
        msg = f"{folder} has no floor in it: no folder with a floor_info.json"
        if (folder / "floor_info.json").exists():
            msg = f"{folder} is a floor: name the folder that it is in, the building"
        raise BuildingFolderError(msg)
    west = min(drawing.box[0] for drawing in drawings)
    south = min(drawing.box[1] for drawing in drawings)
    floors = tuple(_floor(drawing, west, south) for drawing in drawings)
    return BuildingFolder(
        name=folder.resolve().name,
        floors=floors,
        control_points=tuple(_corners(drawings[0], floors[0])),
    )


def _drawing(folder: Path) -> _Drawing:
    size = _json(folder / "floor_info.json")
    features = _json(folder / "geojson_map.json").get("features", [])
    try:
        size_m = float(size["map_info"]["width"]), float(size["map_info"]["height"])
        outline, *rooms = [_area(feature["geometry"]) for feature in features]
        number = int(features[0]["properties"]["floor_num"])
        west, south, east, north = (float(edge) for edge in outline.bounds)
    except (KeyError, TypeError, ValueError, shapely.errors.ShapelyError) as error:
        msg = f"{folder}: size or outline of the floor is missing or unreadable ({error!r})"
        raise BuildingFolderError(msg) from error
    if min(size_m) <= 0 or not (west < east and south < north):
        msg = f"{folder}: the floor has no extent"
        raise BuildingFolderError(msg)
    return _Drawing(folder, size_m, (west, south, east, north), number, outline, tuple(rooms))


def _json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        msg = f"{path}: {error}"
        raise BuildingFolderError(msg) from error
    if not isinstance(document, dict):
        msg = f"{path}: not a JSON object"
        raise BuildingFolderError(msg)
    return document


def _area(geometry: object) -> BaseGeometry:
    """Return the polygons of a hand-drawn geometry, self-crossings mended, lines dropped."""
    if not isinstance(geometry, dict):
        msg = "a feature without geometry"
        raise ValueError(msg)  # noqa: TRY004 - what is wrong is the file, not a call
    parts = shapely.get_parts(shapely.make_valid(shape(geometry)))
    return shapely.union_all([part for part in parts if shapely.get_dimensions(part) == 2])


def _floor(drawing: _Drawing, west: float, south: float) -> FloorFolder:
    x_m_per_deg, y_m_per_deg = drawing.m_per_deg
    x0_m = (drawing.box[0] - west) * x_m_per_deg
    y0_m = (drawing.box[1] - south) * y_m_per_deg

    def to_metres(lon_lat: FloatArray) -> FloatArray:
        return (lon_lat - (west, south)) * (x_m_per_deg, y_m_per_deg)

    outline = shapely.transform(drawing.outline, to_metres)
    rooms = [shapely.transform(room, to_metres) for room in drawing.rooms if not room.is_empty]
    number = drawing.storey_number
    return FloorFolder(
        name=drawing.folder.name,
        ordinal=number - 1 if number > 0 else number,
        x0_m=x0_m,
        y0_m=y0_m,
        width_m=drawing.size_m[0],
        height_m=drawing.size_m[1],
        plan_png=_plan(drawing.folder / "floor_image.png"),
        map_document=floor_map_document([outline], rooms, _outer_walls([outline, *rooms])),
        traces=tuple(trace_paths(drawing.folder)),
    )


def _plan(path: Path) -> bytes:
    try:
        image = path.read_bytes()
    except OSError as error:
        raise BuildingFolderError(str(error)) from error
    if not image.startswith(_PNG_SIGNATURE):
        msg = f"{path}: not a PNG image"
        raise BuildingFolderError(msg)
    return image


def _outer_walls(areas: Iterable[BaseGeometry]) -> Iterator[BaseGeometry]:
    for area in areas:
        for polygon in shapely.get_parts(area):
            yield LineString(np.round(shapely.get_coordinates(polygon.exterior), 3))


def _corners(drawing: _Drawing, floor: FloorFolder) -> Iterator[ControlPoint]:
    west, south, east, north = drawing.box
    x1_m, y1_m = floor.x0_m + floor.width_m, floor.y0_m + floor.height_m
    yield ControlPoint(floor.x0_m, floor.y0_m, south, west)
    yield ControlPoint(x1_m, floor.y0_m, south, east)
    yield ControlPoint(floor.x0_m, y1_m, north, west)
    yield ControlPoint(x1_m, y1_m, north, east)
