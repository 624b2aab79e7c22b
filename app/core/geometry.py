"""Plane geometry of a floor: polygons, walls, and the raster of where people can walk."""

from dataclasses import dataclass

import numpy as np

from app.core.types import BoolArray, FloatArray


def wrap_angle(angle_rad: float) -> float:
    """Return ``angle_rad`` wrapped into [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


CHI2_95 = 5.991
"""Of two degrees of freedom: 95 of 100 places lie within this squared Mahalanobis distance."""


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Half the long and the short axis, and the long one's direction from +x, in [0, pi)."""

    major_m: float
    minor_m: float
    direction_rad: float


def ellipse95(covariance_m2: tuple[float, float, float]) -> Ellipse:
    """Return the ellipse that holds a place in 95 of 100 cases.

    ``(p - m)' C^-1 (p - m) = 5.991``: half axes ``sqrt(5.991 lambda_i)`` along the eigenvectors of
    the covariance ``(xx, xy, yy)``.
    """
    xx, xy, yy = covariance_m2
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    minor_m, major_m = np.sqrt(CHI2_95 * np.maximum(values, 0.0))
    direction_rad = np.arctan2(vectors[1, 1], vectors[0, 1]) % np.pi
    return Ellipse(float(major_m), float(minor_m), float(direction_rad))


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

    def distances_at(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return `distance_at` of many places; x and y have one shape."""
        rows, columns = self.distance_m.shape
        column = np.clip(np.rint((x_m - self.x0_m) / self.cell_m), 0, columns - 1)
        row = np.clip(np.rint((y_m - self.y0_m) / self.cell_m), 0, rows - 1)
        return np.asarray(self.distance_m[row.astype(np.intp), column.astype(np.intp)])

    def cells(self, spacing_m: float) -> FloatArray:
        """Return walkable places (n, 2) on a grid of about this spacing, row by row."""
        stride = max(round(spacing_m / self.cell_m), 1)
        row, column = np.nonzero(self.distance_m[::stride, ::stride] == 0.0)
        return np.column_stack(
            [
                self.x0_m + column * stride * self.cell_m,
                self.y0_m + row * stride * self.cell_m,
            ]
        )


def simplify_line(xy_m: FloatArray, tolerance_m: float) -> BoolArray:
    """Return which points of a line to keep so that it moves by at most ``tolerance_m``.

    Douglas and Peucker (1973): the point farthest from the chord of a stretch is kept while it is
    farther than the tolerance, and splits the stretch.

    Parameters
    ----------
    xy_m : (n, 2), n >= 1

    Returns
    -------
    keep : (n,)
    """
    keep = np.zeros(len(xy_m), dtype=np.bool_)
    keep[[0, -1]] = True
    stretches = [(0, len(xy_m) - 1)]
    while stretches:
        first, last = stretches.pop()
        if last - first < 2:
            continue
        distance_m = _distance_to_chord_m(xy_m[first + 1 : last], xy_m[first], xy_m[last])
        farthest = int(np.argmax(distance_m))
        if distance_m[farthest] > tolerance_m:
            middle = first + 1 + farthest
            keep[middle] = True
            stretches += [(first, middle), (middle, last)]
    return keep


def _distance_to_chord_m(xy_m: FloatArray, start_m: FloatArray, end_m: FloatArray) -> FloatArray:
    chord_m = end_m - start_m
    length2_m2 = float(chord_m @ chord_m)
    along = (xy_m - start_m) @ chord_m / length2_m2 if length2_m2 > 0 else np.zeros(len(xy_m))
    nearest_m = start_m + np.clip(along, 0.0, 1.0)[:, None] * chord_m
    distance_m: FloatArray = np.linalg.norm(xy_m - nearest_m, axis=1)
    return distance_m
