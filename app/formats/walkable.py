"""The raster of where people can walk, from the outlines of a floor plan."""

from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from app.core.geometry import Walkable
from app.core.types import FloatArray

MARGIN_M = 5.0
"""How far the raster reaches beyond the outlines: a stray estimate still sees its distance."""

MAX_CELLS = 4_000_000
"""A square of 1 km at 0.5 m; a larger drawing is a mistake of scale."""


class WalkableError(ValueError):
    """The outlines leave no place to walk, or are too large to raster."""


def rasterise_walkable(
    walkable_polygons: Sequence[BaseGeometry],
    obstacle_polygons: Sequence[BaseGeometry] = (),
    cell_m: float = 0.5,
) -> Walkable:
    """Return the raster of the union of the walkable polygons minus the obstacles.

    A cell is walkable if its centre is; every other cell holds the distance from its centre to the
    nearest walkable centre (exact Euclidean distance transform).

    Raises
    ------
    WalkableError
        If no cell is walkable, or the raster would have more than `MAX_CELLS` cells.
    """
    # Only who draws a floor waits for SciPy, not every server's start.
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415

    area = shapely.union_all(list(walkable_polygons))
    if obstacle_polygons:
        area = shapely.difference(area, shapely.union_all(list(obstacle_polygons)))
    if area.is_empty:
        msg = "the outlines leave no place to walk"
        raise WalkableError(msg)
    xs_m, ys_m = _cell_centres(area.bounds, cell_m)
    shapely.prepare(area)
    inside = np.asarray(shapely.contains_xy(area, *np.meshgrid(xs_m, ys_m)), np.bool_)
    if not inside.any():
        msg = f"no place to walk is as wide as a cell of {cell_m} m"
        raise WalkableError(msg)
    distance_m = distance_transform_edt(np.logical_not(inside), cell_m)
    return Walkable(float(xs_m[0]), float(ys_m[0]), cell_m, np.asarray(distance_m, np.float64))


def _cell_centres(
    bounds_m: tuple[float, float, float, float], cell_m: float
) -> tuple[FloatArray, FloatArray]:
    x_min_m, y_min_m, x_max_m, y_max_m = bounds_m
    columns = int(np.ceil((x_max_m - x_min_m + 2 * MARGIN_M) / cell_m))
    rows = int(np.ceil((y_max_m - y_min_m + 2 * MARGIN_M) / cell_m))
    if columns * rows > MAX_CELLS:
        msg = f"a raster of {columns} by {rows} cells is too large; are the outlines in metres?"
        raise WalkableError(msg)
    xs_m = x_min_m - MARGIN_M + cell_m * (0.5 + np.arange(columns, dtype=np.float64))
    ys_m = y_min_m - MARGIN_M + cell_m * (0.5 + np.arange(rows, dtype=np.float64))
    return xs_m, ys_m
