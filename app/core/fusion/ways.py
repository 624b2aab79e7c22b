"""Ways: in which directions people walk past a place, learned from the walks of its survey.

People go along corridors and aisles and across halls as others did before them. With l_j metres
walked at x_j in direction θ_j, so many metres per m² were walked about a place x, and so many of
them in direction θ:

    w(x) = Σ_j l_j N(x; x_j, s²),   w(x, θ) = Σ_j l_j N(x; x_j, s²) V(θ - θ_j)
    V(δ) = exp(κ cos 2δ) / I_0(κ)   (von Mises; there and back are alike)

A walker who is there goes in direction θ with log odds log (w(x, θ) + ε) / (w(x) + ε) against one
who heeds no way. Where nobody walked (w << ε) all directions are alike.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import i0

from app.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class WayParams:
    """How walks become ways; chosen on ms2020 (folds 1 to 3), flat within a factor of 2.

    Attributes
    ----------
    cell_m
        Edge of a raster cell, and of the pieces that walks are cut into.
    spread_m
        s: how far beside a walk its direction holds, half the width of a corridor.
    concentration
        κ: 5 is a deviation of 13 degrees.
    least_per_m
        ε, metres per m²: a tenth of what one walk brings to where it went.
    directions
        Number of directions of the half turn.
    """

    cell_m: float = 1.0
    spread_m: float = 1.5
    concentration: float = 5.0
    least_per_m: float = 0.022
    directions: int = 16


class Ways(NamedTuple):
    """Log weights of directions, by place.

    Attributes
    ----------
    log_weight : (directions, rows, columns)
        Of direction k + 1/2 of so many to the half turn, counted from east: 0 for the likeliest
        of a place, less for others.
    frame
        Metres east and north of the raster's first cell, and the cell's edge.
    """

    log_weight: FloatArray
    frame: tuple[float, float, float]


NO_WAYS = Ways(np.zeros((1, 1, 1)), (0.0, 0.0, 1.0))
"""Nobody walked anywhere: no direction is likelier than others."""


def ways(paths: FloatArray, east: tuple[float, float], params: WayParams) -> Ways:
    """Return the ways of a floor.

    Parameters
    ----------
    paths : (n, 4)
        x and y of begin and end of each straight piece walked, site frame.
    east
        Cosine and sine of the direction of east on the plan: the raster lies along east, so a plan
        that is turned turns the ways with it.
    """
    place, direction_rad, length_m = _pieces(_from_east(paths, east), params.cell_m)
    if not len(place):
        return NO_WAYS
    margin_m = 4.0 * params.spread_m
    low = place.min(axis=0) - margin_m
    columns, rows = (np.ceil((place.max(axis=0) + margin_m - low) / params.cell_m) + 1).astype(int)
    per_m2 = length_m / params.cell_m**2

    def density(share: FloatArray) -> FloatArray:
        raster = _spread((place - low) / params.cell_m, per_m2 * share, (rows, columns))
        return gaussian_filter(raster, params.spread_m / params.cell_m)

    all_ways = density(np.ones(len(place))) + params.least_per_m
    angle = np.pi * (np.arange(params.directions) + 0.5) / params.directions
    kappa = params.concentration
    share = np.exp(kappa * np.cos(2.0 * (angle[:, None] - direction_rad))) / i0(kappa)
    odds = [np.log((density(s) + params.least_per_m) / all_ways) for s in share]
    log_weight = np.stack(odds)
    log_weight -= log_weight.max(axis=0)
    return Ways(log_weight, (float(low[0]), float(low[1]), params.cell_m))


def _spread(cell: FloatArray, value: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return a raster with each value shared among the four cells about its place (k, 2).

    In proportion to how near they are: a nearest cell alone would change with the last bit.
    """
    raster = np.zeros(shape)
    first = np.floor(cell).astype(int)
    share = cell - first
    for up in (0, 1):
        for right in (0, 1):
            part = np.abs(1 - right - share[:, 0]) * np.abs(1 - up - share[:, 1])
            np.add.at(raster, (first[:, 1] + up, first[:, 0] + right), part * value)
    return raster


def _from_east(paths: FloatArray, east: tuple[float, float]) -> FloatArray:
    """Return paths (n, 2, 2) as metres east and north of the origin."""
    turn = np.array([[east[0], -east[1]], [east[1], east[0]]])
    return np.asarray(paths.reshape(-1, 2, 2) @ turn)


def _pieces(paths: FloatArray, piece_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cut paths into pieces of about this length: middle (k, 2), direction and length (k,)."""
    way = paths[:, 1] - paths[:, 0]
    length_m = np.linalg.norm(way, axis=1)
    # Lengths are often round numbers, and their last bit must not decide.
    count = np.ceil(length_m / piece_m - 0.1).clip(1).astype(int)
    path = np.repeat(np.arange(len(paths)), count)
    nth = np.arange(len(path)) - np.repeat(np.cumsum(count) - count, count)
    share = (nth + 0.5) / count[path]
    middle = paths[path, 0] + share[:, None] * way[path]
    return middle, np.arctan2(way[path, 1], way[path, 0]), (length_m / count)[path]
