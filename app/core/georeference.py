"""Where a site lies on the globe: an affine fit of its metric frame to WGS84 control points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.core.types import FloatArray

# WGS84: equatorial radius and the square of the first eccentricity.
_EQUATOR_M = 6_378_137.0
_ECCENTRICITY2 = 6.694_379_990_14e-3

MIN_SPREAD_M = 1.0
"""Control points closer together than this say nothing about scale and direction."""


@dataclass(frozen=True, slots=True)
class ControlPoint:
    """One place known in both frames."""

    x_m: float
    y_m: float
    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, slots=True)
class Georeference:
    """Affine map of the site frame to a plane tangent to the globe at ``lat0_deg, lon0_deg``.

    Attributes
    ----------
    matrix
        ``(a, b, c, d)``: east = a x + b y + ``east0_m``, north = c x + d y + ``north0_m``.
    residual_rms_m
        Root mean square distance of the control points from where the fit puts them.
    """

    lat0_deg: float
    lon0_deg: float
    matrix: tuple[float, float, float, float]
    east0_m: float
    north0_m: float
    residual_rms_m: float

    @property
    def x_axis_from_east_rad(self) -> float:
        """Direction of the site frame's +x axis, radians counter-clockwise from east.

        The rotation of the polar decomposition of the matrix, atan2(c - b, a + d): the frame's two
        scales do not turn it, and its shear is shared by both axes.
        """
        a, b, c, d = self.matrix
        return math.atan2(c - b, a + d)

    def to_wgs84(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return latitude and longitude of a place in the site frame, degrees."""
        a, b, c, d = self.matrix
        east_m = a * x_m + b * y_m + self.east0_m
        north_m = c * x_m + d * y_m + self.north0_m
        per_lat_m, per_lon_m = _metres_per_degree(self.lat0_deg)
        return self.lat0_deg + north_m / per_lat_m, self.lon0_deg + east_m / per_lon_m

    def from_wgs84(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return the place in the site frame of a latitude and longitude: `to_wgs84` undone."""
        a, b, c, d = self.matrix
        per_lat_m, per_lon_m = _metres_per_degree(self.lat0_deg)
        east_m = (lon_deg - self.lon0_deg) * per_lon_m - self.east0_m
        north_m = (lat_deg - self.lat0_deg) * per_lat_m - self.north0_m
        determinant = a * d - b * c
        x_m = (d * east_m - b * north_m) / determinant
        return x_m, (a * north_m - c * east_m) / determinant


def fit_georeference(points: Sequence[ControlPoint]) -> Georeference:
    """Return the least-squares fit: a similarity for two points, an affine map for three or more.

    Solves ``[x y 1] M = [east north]``; with two points ``M`` is restricted to a rotation with one
    scale. The plane is tangent at the centroid, which over a site of kilometres is off by
    millimetres.

    Raises
    ------
    ValueError
        If there are fewer than two points, or they do not span a plane (two: a line).
    """
    if len(points) < 2:
        msg = "a georeference needs at least two control points"
        raise ValueError(msg)
    local_m = np.array([(p.x_m, p.y_m) for p in points], dtype=np.float64)
    lat0_deg = float(np.mean([p.lat_deg for p in points]))
    lon0_deg = float(np.mean([p.lon_deg for p in points]))
    per_lat_m, per_lon_m = _metres_per_degree(lat0_deg)
    world_m = np.array(
        [((p.lon_deg - lon0_deg) * per_lon_m, (p.lat_deg - lat0_deg) * per_lat_m) for p in points],
        dtype=np.float64,
    )
    for frame_m in (local_m, world_m):
        _check_spread(frame_m, 1 if len(points) == 2 else 2)
    fit = _similarity(local_m, world_m) if len(points) == 2 else _affine(local_m, world_m)
    design = np.column_stack((local_m, np.ones(len(points))))
    residual_m = design @ fit - world_m
    (a, c), (b, d), (east0_m, north0_m) = fit.tolist()
    rms_m = float(np.sqrt(np.mean(np.sum(residual_m**2, axis=1))))
    return Georeference(lat0_deg, lon0_deg, (a, b, c, d), east0_m, north0_m, rms_m)


def _metres_per_degree(lat_deg: float) -> tuple[float, float]:
    """Return metres per degree of latitude and of longitude from the radii of curvature."""
    sin, cos = math.sin(math.radians(lat_deg)), math.cos(math.radians(lat_deg))
    w2 = 1.0 - _ECCENTRICITY2 * sin * sin
    meridian_m = _EQUATOR_M * (1.0 - _ECCENTRICITY2) / w2**1.5
    prime_vertical_m = _EQUATOR_M / math.sqrt(w2)
    return math.radians(meridian_m), math.radians(prime_vertical_m * cos)


def _check_spread(points_m: FloatArray, dimensions: int) -> None:
    """Refuse points that (nearly) coincide, or for an affine fit lie on a line."""
    spread_m = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    if spread_m[dimensions - 1] < MIN_SPREAD_M / 2:
        msg = "the control points coincide" if dimensions == 1 else "they lie on one line"
        raise ValueError(msg)


def _affine(local_m: FloatArray, world_m: FloatArray) -> FloatArray:
    design = np.column_stack((local_m, np.ones(len(local_m))))
    return np.asarray(np.linalg.lstsq(design, world_m, rcond=None)[0], np.float64)


def _similarity(local_m: FloatArray, world_m: FloatArray) -> FloatArray:
    """Solve rotation, scale and shift from two points: division of complex numbers."""
    local, world = local_m @ (1, 1j), world_m @ (1, 1j)
    turn = (world[1] - world[0]) / (local[1] - local[0])
    shift = world[0] - turn * local[0]
    return np.array(
        [
            (turn.real, turn.imag),
            (-turn.imag, turn.real),
            (shift.real, shift.imag),
        ]
    )
