"""Kernels that look at the whole cost surface: where its basins are, and what the posterior spans.

The level model is not convex: anchors in a row cannot tell the two sides of the row apart, and few
anchors leave several places that fit. So the cost of the static model, on the mean level per
anchor, is evaluated on a grid over the box in which the phone must be. Its local minima are the
starting points of Gauss-Newton, and where the minimum's own covariance does not tell the truth (see
`is_gaussian`), the moments of the posterior ``exp(-C / 2)`` on a grid do.

The grid lies along the principal axes of the anchors heard, so that a turned layout gives the same
answer, turned, and both sides of a row of anchors are treated alike.

Only what loops over readings is compiled; what is done once per fix is plain NumPy, which starts
sooner.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.lateration.gauss_newton import Priors, Rows, minimise
from app.core.radio.path_loss import DZ2, INTERCEPT, SLOPE, X, Y, squared_distance
from app.core.types import BoolArray, FloatArray

Surface: TypeAlias = tuple[Rows, FloatArray, FloatArray, Priors]
"""What the cost of a place depends on: the mean level of each anchor heard (one row per anchor),
the model's table, the search box (see `box_around`) and the priors. An infinite information of the
offset says that the phone is as calibrated."""

COARSE, FINE = 9, 31
"""Cells per side: for finding basins (Gauss-Newton does the rest), and for moments. Odd numbers put
cells on the principal axes."""

RIVAL_CHI2 = 9.21
"""A basin whose cost is this much above the best is out: 99 % point of chi-square, 2 degrees."""

LEAST_RISE, MOST_RISE = 2.0, 8.0
"""Two standard deviations off the minimum of a parabola the cost is 4 higher. Where it is less or
more than this, the surface is wider than 1.4 or narrower than 0.7 of what the covariance says."""

SUPPORT_CHI2 = 20.0
"""Cells above the least cost by more than this hold under 1e-4 of the posterior."""


def box_around(places: FloatArray, margin_m: float) -> FloatArray:
    """Return centre (x, y), axis (x, y), half length, half width and margin of the box.

    Parameters
    ----------
    places : (n, 2)
        Anchors heard; the axis is the one of their largest spread.
    margin_m
        How far the box reaches beyond them.
    """
    dx, dy = (places - places.mean(axis=0)).T
    angle = 0.5 * math.atan2(2.0 * float(dx @ dy), float(dx @ dx - dy @ dy))
    c, s = math.cos(angle), math.sin(angle)
    turned = places @ np.array([[c, -s], [s, c]])
    low, high = turned.min(axis=0), turned.max(axis=0)
    (a, b), (half_a, half_b) = 0.5 * (low + high), 0.5 * (high - low) + margin_m
    return np.array([c * a - s * b, s * a + c * b, c, s, half_a, half_b, margin_m])


def corners_around(places: FloatArray) -> FloatArray:
    """Return the corners (4, 2) of the upright rectangle around places (n, 2)."""
    (left, low), (right, high) = places.min(axis=0), places.max(axis=0)
    return np.array([(left, low), (right, low), (right, high), (left, high)])


def inside(box: FloatArray, state: FloatArray) -> bool:
    """Return whether a place lies in the search box."""
    along, across = in_box(box, state[0], state[1])
    return bool(abs(along) <= box[4] and abs(across) <= box[5])


@register_jitable
def in_box(box: FloatArray, x_m: float, y_m: float) -> tuple[float, float]:
    """Return a place (m) along and across the box, from its centre."""
    dx, dy = x_m - box[0], y_m - box[1]
    return box[2] * dx + box[3] * dy, box[2] * dy - box[3] * dx


@njit(cache=True)
def costs_at(surface: Surface, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return the static costs at places (n,), each at the phone offset that fits best there.

    A place outside the anchors' own box costs as a normal deviation of a third of the margin:
    people are where the anchors were put. Levels outweigh that, but when the phone's offset is
    unknown they do not tell a place inside the circle through the anchors from its inversion
    outside.
    """
    means, table, box, priors = surface
    k, _, offset_information = priors
    precision = means[3]
    residual = np.empty(len(precision))
    costs = np.empty(len(x_m))
    for m in range(len(x_m)):
        _fill_residuals(means, table, x_m[m], y_m[m], residual)
        cost = outside_cost(box, x_m[m], y_m[m])
        offset = 0.0
        if offset_information < np.inf:
            weighted, total = 0.0, offset_information
            for j in range(len(precision)):
                weighted += precision[j] ** 2 * residual[j]
                total += precision[j] ** 2
            offset = weighted / total
            cost += offset * offset * offset_information
        for j in range(len(precision)):
            z = abs(residual[j] - offset) * precision[j]
            cost += z * z if z <= k else 2.0 * k * z - k * k
        costs[m] = cost
    return costs


@register_jitable
def _fill_residuals(
    means: Rows, table: FloatArray, x_m: float, y_m: float, residual_db: FloatArray
) -> None:
    """Fill (means,) with measured minus expected levels at a place."""
    anchor, _, level_dbm, _ = means
    for j in range(len(anchor)):
        i = anchor[j]
        d2 = squared_distance(x_m - table[i, X], y_m - table[i, Y], table[i, DZ2])
        residual_db[j] = level_dbm[j] - table[i, INTERCEPT] + 0.5 * table[i, SLOPE] * np.log(d2)


@register_jitable
def outside_cost(box: FloatArray, x_m: float, y_m: float) -> float:
    """Return the place prior's cost."""
    along, across = in_box(box, x_m, y_m)
    far = max(abs(along) - box[4] + box[6], 0.0)
    wide = max(abs(across) - box[5] + box[6], 0.0)
    return float((far * far + wide * wide) * 9.0 / (box[6] * box[6]))


def places_in(box: FloatArray, cells: int) -> tuple[FloatArray, FloatArray]:
    """Return x and y (cells squared,) of the centres of a box's cells, along its axis first."""
    steps = (2.0 * np.arange(cells) + 1.0) / cells - 1.0
    along, across = (box[4] * steps)[:, None], box[5] * steps
    x = box[0] + box[2] * along - box[3] * across
    y = box[1] + box[3] * along + box[2] * across
    return x.ravel(), y.ravel()


def basins(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Return the minima of the static cost, (basins, p) with p 2 or 3, and their costs (basins,).

    Two passes: from the local minima of a coarse grid, then from the best minimum turned about its
    nearest anchor by quarter turns, because the basins around an anchor are closer than the cells.
    """
    box, priors = surface[2], surface[3]
    x, y = places_in(box, COARSE)
    lowest = local_minima(costs_at(surface, x, y).reshape(COARSE, COARSE)).ravel()
    starts = np.zeros((np.count_nonzero(lowest), 3 if priors[2] < np.inf else 2))
    starts[:, 0], starts[:, 1] = x[lowest], y[lowest]
    first, first_costs = _descend(surface, starts)
    turned = _quarter_turns(surface, first[np.argmin(first_costs)])
    second, second_costs = _descend(surface, turned)
    return np.concatenate((first, second)), np.concatenate((first_costs, second_costs))


def local_minima(costs: FloatArray) -> BoolArray:
    """Return which cells (cells, cells) no neighbour undercuts."""
    framed = np.full((len(costs) + 2, len(costs) + 2), np.inf)
    framed[1:-1, 1:-1] = costs
    rows = np.minimum(np.minimum(framed[:-2], framed[1:-1]), framed[2:])
    least = np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
    return np.asarray(costs <= least)


def _descend(surface: Surface, starts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minima (n, p) reached from starts (n, p), and their costs (n,)."""
    means, table, _, priors = surface
    reached = np.array([minimise(means, table, start, priors)[0] for start in starts])
    x, y = reached[:, :2].T.copy()
    return reached, costs_at(surface, x, y)


def _quarter_turns(surface: Surface, state: FloatArray) -> FloatArray:
    """Return (3, p): a state turned about its nearest anchor by one, two and three quarters."""
    places = surface[1][surface[0][0], X : Y + 1]
    away = state[:2] - places
    nearest = np.argmin((away * away).sum(axis=1))
    dx, dy = away[nearest]
    turned = np.tile(state, (3, 1))
    turned[:, :2] = places[nearest] + np.array([[-dy, dx], [-dx, -dy], [dy, -dx]])
    return turned


def is_gaussian(
    surface: Surface, place: FloatArray, D: FloatArray, found: tuple[FloatArray, FloatArray]
) -> bool:
    """Return whether the covariance D (2, 2) of the best place tells what the surface says.

    It does if no rival basin outside its 3-sigma ellipse is plausible, and if two standard
    deviations along its axes raise the cost by `LEAST_RISE` to `MOST_RISE` (4 on an exact
    parabola).
    """
    det = D[0, 0] * D[1, 1] - D[0, 1] ** 2
    states, costs = found
    dx, dy = states[:, 0] - place[0], states[:, 1] - place[1]
    distance2 = (D[1, 1] * dx * dx - 2.0 * D[0, 1] * dx * dy + D[0, 0] * dy * dy) / det
    if np.any((costs < costs.min() + RIVAL_CHI2) & (distance2 > 9.0)):
        return False
    angle = 0.5 * math.atan2(2.0 * D[0, 1], D[0, 0] - D[1, 1])
    mean, spread = 0.5 * (D[0, 0] + D[1, 1]), math.hypot(0.5 * (D[0, 0] - D[1, 1]), D[0, 1])
    major, minor = 2.0 * math.sqrt(mean + spread), 2.0 * math.sqrt(max(mean - spread, 0.0))
    c, s = math.cos(angle), math.sin(angle)
    x = place[0] + np.array([0.0, major * c, -minor * s, -major * c, minor * s])
    y = place[1] + np.array([0.0, major * s, minor * c, -major * s, -minor * c])
    at_place, *around = costs_at(surface, x, y).tolist()
    return all(LEAST_RISE <= cost - at_place <= MOST_RISE for cost in around)


def posterior_moments(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Return mean (2,) and covariance (2, 2) of the static posterior ``exp(-C / 2)`` within a box.

    The place prior is that of `costs_at`.
    """
    mean, covariance, _ = spread_over(
        surface[2], lambda x_m, y_m: costs_at(surface, x_m, y_m), FINE
    )
    return mean, covariance


def spread_over(
    box: FloatArray, costs_of: Callable[[FloatArray, FloatArray], FloatArray], cells: int
) -> tuple[FloatArray, FloatArray, float]:
    """Return mean (2,) and covariance (2, 2) of ``exp(-C / 2)`` within a box, C of places (n,).

    The third is the logarithm of its integral, m².

    The grid is laid twice: over the whole box, then over the part that the posterior occupies. A
    cell's own extent is part of the covariance.
    """
    support = _support_of(costs_of(*places_in(box, cells)).reshape(cells, cells), box)
    places = np.stack(places_in(support, cells))
    costs = costs_of(places[0], places[1])
    least = costs.min()
    weights = np.exp(-0.5 * (costs - least))
    total = float(weights.sum())
    weights /= total
    mean = places @ weights
    apart = places - mean[:, None]
    cell2 = max(support[4], support[5]) ** 2 / (3.0 * cells * cells)
    covariance = (apart * weights) @ apart.T + cell2 * np.eye(2)
    cell_m2 = 4.0 * support[4] * support[5] / (cells * cells)
    return mean, covariance, math.log(total * cell_m2) - 0.5 * float(least)


def _support_of(costs: FloatArray, box: FloatArray) -> FloatArray:
    """Return the part of a box, one cell wider, where the cost is near its least value."""
    cells = len(costs)
    near = costs <= costs.min() + SUPPORT_CHI2
    half, middle = np.empty(2), np.empty(2)
    for axis in range(2):
        occupied = np.flatnonzero(near.any(axis=1 - axis))
        low, high = max(occupied[0] - 1, 0), min(occupied[-1] + 1, cells - 1)
        half[axis] = box[4 + axis] * (high - low + 1) / cells
        middle[axis] = box[4 + axis] * ((low + high + 1) / cells - 1.0)
    x = box[0] + box[2] * middle[0] - box[3] * middle[1]
    y = box[1] + box[3] * middle[0] + box[2] * middle[1]
    return np.array([x, y, box[2], box[3], half[0], half[1], 0.0])
