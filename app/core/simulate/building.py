"""The warehouse itself: two floors of 80 x 50 m with racks, walls, stairs and a lift.

Both floors share one frame. Everything is laid out by hand here, nothing is random: a plan drawn
from it is the same for every seed.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from scipy.ndimage import distance_transform_edt

from app.core.geometry import Walkable
from app.core.site import Floor, Wall
from app.core.types import BoolArray, FloatArray

Segment: TypeAlias = tuple[float, float, float, float]

WIDTH_M, HEIGHT_M = 80.0, 50.0
STOREY_HEIGHT_M = 4.5
CELL_M = 0.5

# Loss per face of a loaded pallet rack, per light partition and per masonry wall at 2.4 GHz:
# mid-range of the values that site-survey handbooks give (2 to 6 dB for a stocked rack,
# 3 to 4 dB for a partition, 6 to 10 dB for brick).
RACK_FACE_DB, PARTITION_DB, MASONRY_DB = 2.5, 4.0, 8.0


class ConnectorKind(StrEnum):
    """How people change floors."""

    STAIRS = "stairs"
    LIFT = "lift"


@dataclass(frozen=True, slots=True)
class Rack:
    """Footprint of a rack: lower left corner and size."""

    x0_m: float
    y0_m: float
    width_m: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class Connector:
    """A way between floor 0 and floor 1, and its footprint.

    Attributes
    ----------
    lower_m, upper_m
        (x, y) where it is entered on floor 0 and left on floor 1.
    duration_s
        From one to the other, waiting for the lift not included.
    """

    kind: ConnectorKind
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]
    duration_s: float
    footprint: Rack

    def covers(self, x_m: float, y_m: float) -> bool:
        """Return whether (x, y) lies in the footprint."""
        box = self.footprint
        inside_x = box.x0_m <= x_m <= box.x0_m + box.width_m
        return inside_x and box.y0_m <= y_m <= box.y0_m + box.depth_m


@dataclass(frozen=True, slots=True)
class Storey:
    """One floor as laid out: racks, partitions, masonry, and the lines that people walk along."""

    floor_id: str
    name: str
    racks: tuple[Rack, ...]
    partitions: tuple[Segment, ...]
    masonry: tuple[Segment, ...]
    aisles: tuple[Segment, ...]


STAIRS = Connector(
    ConnectorKind.STAIRS, (75.5, 8.0), (75.5, 20.0), 15.0, Rack(74.0, 8.0, 3.0, 12.0)
)
LIFT = Connector(ConnectorKind.LIFT, (71.5, 30.25), (71.5, 30.25), 8.0, Rack(70.0, 29.0, 3.0, 2.5))
CONNECTORS = (STAIRS, LIFT)

_SHAFT: tuple[Segment, ...] = ((70, 29, 73, 29), (73, 29, 73, 31.5), (70, 31.5, 73, 31.5))
_STAIRWELL: tuple[Segment, ...] = ((74, 8, 74, 20), (77, 8, 77, 20))
_OUTSIDE: tuple[Segment, ...] = (
    (0, 0, WIDTH_M, 0),
    (WIDTH_M, 0, WIDTH_M, HEIGHT_M),
    (0, HEIGHT_M, WIDTH_M, HEIGHT_M),
    (0, 0, 0, HEIGHT_M),
)

GROUND = Storey(
    floor_id="ground",
    name="Ground floor",
    racks=tuple(Rack(6.0 + 5.0 * i, y0, 2.0, 15.0) for y0 in (7.0, 28.0) for i in range(10)),
    partitions=((70, 37, 80, 37), (70, 37, 70, 44.5), (70, 47.5, 70, 50)),
    masonry=(*_SHAFT, *_STAIRWELL, (74, 20, 77, 20)),
    aisles=(
        *((3, y, 77, y) for y in (4.0, 25.0, 46.0)),
        (3, 4, 3, 46),
        *((9.5 + 5.0 * i, 4, 9.5 + 5.0 * i, 46) for i in range(10)),
        (60, 4, 60, 46),
        (68, 4, 68, 46),
        (75.5, 4, 75.5, 8),
        (68, 30.25, 71.5, 30.25),
        (75.5, 40, 75.5, 46),
    ),
)
UPPER = Storey(
    floor_id="upper",
    name="Upper floor",
    racks=tuple(
        Rack(x0, y0, width, 2.5)
        for x0, width in ((7.0, 28.0), (41.0, 20.0))
        for y0 in (6.0, 12.0, 18.0, 29.5, 35.5, 41.5)
    ),
    partitions=((65, 37, 80, 37), (65, 37, 65, 45.5), (65, 48.5, 65, 50), (65, 0, 65, 20)),
    masonry=(*_SHAFT, *_STAIRWELL, (74, 8, 77, 8)),
    aisles=(
        *((4, y, 63, y) for y in (3.0, 10.25, 16.25, 33.75, 39.75)),
        (4, 25, 75.5, 25),
        (4, 47, 77, 47),
        *((x, 3, x, 47) for x in (4.0, 38.0, 63.0)),
        (68, 4, 68, 30.25),
        (68, 30.25, 71.5, 30.25),
        (68, 40, 68, 47),
        (75.5, 20, 75.5, 25),
    ),
)
STOREYS = (GROUND, UPPER)


def floors(site_id: str) -> tuple[Floor, ...]:
    """Return the floors of the site model, walls and walkable raster included."""
    return tuple(
        Floor(
            floor_id=f"{site_id}-{storey.floor_id}",
            name=storey.name,
            building="Warehouse",
            ordinal=ordinal,
            x0_m=0.0,
            y0_m=0.0,
            width_m=WIDTH_M,
            height_m=HEIGHT_M,
            walkable=_walkable(storey),
            walls=walls_of(storey),
        )
        for ordinal, storey in enumerate(STOREYS)
    )


def walls_of(storey: Storey) -> tuple[Wall, ...]:
    """Return everything that weakens a level on its way: rack faces, partitions, masonry."""
    masonry = (*_OUTSIDE, *storey.masonry)
    return (
        *(Wall(*face, RACK_FACE_DB) for rack in storey.racks for face in _faces(rack)),
        *(Wall(*segment, PARTITION_DB) for segment in storey.partitions),
        *(Wall(*segment, MASONRY_DB) for segment in masonry),
    )


def _faces(rack: Rack) -> tuple[Segment, ...]:
    x0, y0, x1, y1 = rack.x0_m, rack.y0_m, rack.x0_m + rack.width_m, rack.y0_m + rack.depth_m
    return ((x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1), (x0, y0, x0, y1))


def _walkable(storey: Storey) -> Walkable:
    """Rasterise a storey: racks and walls are closed, all other floor can be walked on."""
    columns, rows = round(WIDTH_M / CELL_M), round(HEIGHT_M / CELL_M)
    x_m, y_m = np.meshgrid((np.arange(columns) + 0.5) * CELL_M, (np.arange(rows) + 0.5) * CELL_M)
    closed: BoolArray = np.zeros((rows, columns), dtype=np.bool_)
    for rack in storey.racks:
        inside_x = (x_m >= rack.x0_m) & (x_m <= rack.x0_m + rack.width_m)
        closed |= inside_x & (y_m >= rack.y0_m) & (y_m <= rack.y0_m + rack.depth_m)
    for segment in (*storey.partitions, *storey.masonry):
        closed |= _near_segment(x_m, y_m, segment)
    distance_m: FloatArray = np.asarray(distance_transform_edt(closed), dtype=np.float64) * CELL_M
    return Walkable(CELL_M / 2.0, CELL_M / 2.0, CELL_M, distance_m)


def _near_segment(x_m: FloatArray, y_m: FloatArray, segment: Segment) -> BoolArray:
    """Return which cells an axis-parallel segment passes (it lies on edges between cells)."""
    x0, y0, x1, y1 = segment
    reach_m = CELL_M / 2.0
    near_x = (x_m >= min(x0, x1) - reach_m) & (x_m <= max(x0, x1) + reach_m)
    return near_x & (y_m >= min(y0, y1) - reach_m) & (y_m <= max(y0, y1) + reach_m)
