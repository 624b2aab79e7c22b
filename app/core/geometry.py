"""Plane geometry of a floor: polygons, walls, and the raster of where people can walk."""

from dataclasses import dataclass

import numpy as np

from app.core.types import FloatArray


def wrap_angle(angle_rad: float) -> float:
    """Return ``angle_rad`` wrapped into [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Walkable:
    """Distance to the nearest walkable place, on a square grid.

    Attributes
    ----------
    x0_m, y0_m
        Centre of cell (0, 0) in the site frame.
    cell_m
        Edge length of a cell.
    distance_m : (rows, columns)
        Distance from the cell's centre to walkable floor, 0 on it; row index grows with y.
    """

    x0_m: float
    y0_m: float
    cell_m: float
    distance_m: FloatArray

    def distance_at(self, x_m: float, y_m: float) -> float:
        """Return the distance from (x, y) to walkable floor; beyond the raster, the edge cell's."""
        rows, columns = self.distance_m.shape
        column = min(max(round((x_m - self.x0_m) / self.cell_m), 0), columns - 1)
        row = min(max(round((y_m - self.y0_m) / self.cell_m), 0), rows - 1)
        return float(self.distance_m[row, column])
