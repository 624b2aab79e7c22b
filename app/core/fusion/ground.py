"""The ground of a floor: where people can walk on it, and which ways they go."""

import math
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from app.core.fusion.ways import NO_WAYS, Ways
from app.core.geometry import Walkable
from app.core.types import FloatArray


class Ground(NamedTuple):
    """What particles move on.

    Attributes
    ----------
    distance_m : (rows, columns)
        Distance to walkable floor (see `Walkable`).
    frame
        x and y of the raster's first cell, and the cell's edge, m.
    east
        Cosine and sine of the direction of east on the plan.
    east_rad
        That direction.
    ways
        In which directions people walk.
    """

    distance_m: FloatArray
    frame: tuple[float, float, float]
    east: tuple[float, float]
    east_rad: float
    ways: Ways


_EVERYWHERE = np.zeros((1, 1))


def ground(walkable: Walkable | None, east: tuple[float, float], known: Ways = NO_WAYS) -> Ground:
    """Return the ground of a floor; None: nobody said where people can walk."""
    east_rad = math.atan2(east[1], east[0])
    if walkable is None:
        return Ground(_EVERYWHERE, (0.0, 0.0, 1.0), east, east_rad, known)
    frame = walkable.x0_m, walkable.y0_m, walkable.cell_m
    return Ground(walkable.distance_m, frame, east, east_rad, known)


@register_jitable
def off_floor_m(floor: Ground, x_m: float, y_m: float, far_m: float) -> float:
    """Return how far a place is off the walkable floor, at most ``far_m``."""
    distance_m, frame = floor[0], floor[1]
    rows, columns = distance_m.shape
    column = math.floor((x_m - frame[0]) / frame[2] + 0.5)
    row = math.floor((y_m - frame[1]) / frame[2] + 0.5)
    off_m = distance_m[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)]
    return float(min(off_m, far_m))


@register_jitable
def way_log_weight(floor: Ground, x_m: float, y_m: float, direction_rad: float) -> float:
    """Return what the ways say of a direction at a place; beyond them, nothing."""
    _, _, (cos, sin), east_rad, (log_weight, (east_m, north_m, cell_m)) = floor
    directions, rows, columns = log_weight.shape
    column = math.floor((x_m * cos + y_m * sin - east_m) / cell_m + 0.5)
    row = math.floor((y_m * cos - x_m * sin - north_m) / cell_m + 0.5)
    if not (0 <= row < rows and 0 <= column < columns):
        return 0.0
    half_turns = (direction_rad - east_rad) / math.pi
    which = int((half_turns - math.floor(half_turns)) * directions)
    # A direction just short of the half turn may round to all of it.
    return float(log_weight[which if which < directions else 0, row, column])
