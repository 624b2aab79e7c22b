"""Kernels that look at the whole cost surface: where its basins are, and what the posterior spans.

The level model is not convex: anchors in a row cannot tell the two sides of the row apart, and few
anchors leave several places that fit. So the cost of the static model, on the mean level per
anchor, is evaluated on a grid over the box in which the phone must be. Its local minima are the
starting points of Gauss-Newton, and where the minimum's own covariance does not tell the truth (see
`is_gaussian`), the moments of the posterior ``exp(-C / 2)`` on a grid do.

The grid lies along the principal axes of the anchors heard, so that a turned layout gives the same
answer, turned, and both sides of a row of anchors are treated alike.
"""

import numpy as np
from numba import njit

from app.core.lateration.gauss_newton import minimise
from app.core.radio.path_loss import DZ2, INTERCEPT, SLOPE, X, Y, squared_distance
from app.core.types import FloatArray, IntArray

COARSE, FINE = 9, 41
"""Cells per side: for finding basins (Gauss-Newton does the rest), and for moments. Odd numbers put
cells on the principal axes."""

MOST_BASINS = 6
"""Local minima that are followed; more than four have not been seen with three anchors or more."""

RIVAL_CHI2 = 9.21
"""A basin whose cost is this much above the best is out: 99 % point of chi-square, 2 degrees."""

SUPPORT_CHI2 = 20.0
"""Cells above the least cost by more than this hold under 1e-4 of the posterior."""


@njit(cache=True)
def box_around(places: FloatArray, margin_m: float) -> FloatArray:
    """Return ``(centre x, centre y, axis x, axis y, half length, half width)`` of the search box.

    Parameters
    ----------
    places : (n, 2)
        Anchors heard; the axis is the one of their largest spread.
    margin_m
        How far the box reaches beyond them.
    """
    dx, dy = places[:, 0] - places[:, 0].mean(), places[:, 1] - places[:, 1].mean()
    angle = 0.5 * np.arctan2(2.0 * (dx * dy).sum(), (dx * dx - dy * dy).sum())
    c, s = np.cos(angle), np.sin(angle)
    along, across = c * places[:, 0] + s * places[:, 1], c * places[:, 1] - s * places[:, 0]
    a, b = 0.5 * (along.min() + along.max()), 0.5 * (across.min() + across.max())
    half_a, half_b = 0.5 * (along.max() - along.min()), 0.5 * (across.max() - across.min())
    return np.array([c * a - s * b, s * a + c * b, c, s, half_a + margin_m, half_b + margin_m])


@njit(cache=True)
def cost_at(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    x_m: float,
    y_m: float,
    k: float,
    offset_information: float,
) -> float:
    """Return the static cost at a place, at the phone offset that fits best there.

    Parameters
    ----------
    means
        As ``readings`` of `normal_equations`, one row per anchor.
    k
        Huber's.
    offset_information
        ``1 / sigma_o^2`` (1/dB^2); infinite when the phone is as calibrated.
    """
    precision = means[3]
    offset: float = 0.0
    cost: float = 0.0
    if offset_information < np.inf:
        weighted, total = 0.0, offset_information
        for j in range(len(precision)):
            weighted += precision[j] ** 2 * _residual(means, table, j, x_m, y_m)
            total += precision[j] ** 2
        offset = weighted / total
        cost = offset * offset * offset_information
    for j in range(len(precision)):
        z = abs(_residual(means, table, j, x_m, y_m) - offset) * precision[j]
        cost += z * z if z <= k else 2.0 * k * z - k * k
    return cost


@njit(cache=True, inline="always")
def _residual(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    j: int,
    x_m: float,
    y_m: float,
) -> float:
    """Return measured minus expected level (dB) of mean j at a place."""
    i = means[0][j]
    d2 = squared_distance(x_m - table[i, X], y_m - table[i, Y], table[i, DZ2])
    return float(means[2][j] - table[i, INTERCEPT] + 0.5 * table[i, SLOPE] * np.log(d2))


@njit(cache=True)
def costs_on(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    box: FloatArray,
    cells: int,
    k: float,
    offset_information: float,
) -> FloatArray:
    """Return the cost at the cells' centres, (cells, cells): first index along the box's axis."""
    costs = np.empty((cells, cells))
    for a in range(cells):
        for b in range(cells):
            x, y = place_in(box, cells, a, b)
            costs[a, b] = cost_at(means, table, x, y, k, offset_information)
    return costs


@njit(cache=True)
def place_in(box: FloatArray, cells: int, a: int, b: int) -> tuple[float, float]:
    """Return the centre (m) of a cell of a box."""
    along = box[4] * ((2 * a + 1) / cells - 1.0)
    across = box[5] * ((2 * b + 1) / cells - 1.0)
    return box[0] + box[2] * along - box[3] * across, box[1] + box[3] * along + box[2] * across


@njit(cache=True)
def local_minima(costs: FloatArray) -> IntArray:
    """Return up to `MOST_BASINS` cells that no neighbour undercuts, (minima, 2), lowest first."""
    cells = len(costs)
    found = np.empty((cells * cells, 2), np.int64)
    value = np.empty(cells * cells)
    count = 0
    for a in range(cells):
        for b in range(cells):
            around = costs[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2]
            if costs[a, b] <= around.min():
                found[count, 0], found[count, 1] = a, b
                value[count] = costs[a, b]
                count += 1
    order = np.argsort(value[:count], kind="mergesort")[:MOST_BASINS]
    return found[order]


@njit(cache=True)
def basins(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    box: FloatArray,
    priors: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the best static state, its information and how far the others are above it.

    Returns
    -------
    state : (2,) or (3,)
        Position and, with an offset prior, offset.
    A : (p, p)
        Information there.
    rivals : (minima, 3)
        ``(x, y, cost - best cost)`` of every basin found, the best included.
    """
    k, _, offset_information = priors
    with_offset = offset_information < np.inf
    costs = costs_on(means, table, box, COARSE, k, offset_information)
    cells = local_minima(costs)
    rivals = np.empty((len(cells), 3))
    start = np.zeros(3 if with_offset else 2)
    best, best_cost, best_A = start, np.inf, np.zeros((len(start), len(start)))
    for m in range(len(cells)):
        start[0], start[1] = place_in(box, COARSE, cells[m, 0], cells[m, 1])
        state, cost, A = minimise(means, table, start, (False, with_offset), priors)
        rivals[m, 0], rivals[m, 1], rivals[m, 2] = state[0], state[1], cost
        if cost < best_cost:
            best, best_cost, best_A = state, cost, A
    rivals[:, 2] -= best_cost
    return best, best_A, rivals


@njit(cache=True)
def is_gaussian(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    place: FloatArray,
    D: FloatArray,
    rivals: FloatArray,
    priors: tuple[float, float, float],
) -> bool:
    """Return whether the covariance D (2, 2) of the best place tells what the surface says.

    It does if no rival basin outside its 3-sigma ellipse is plausible, and if two standard
    deviations along its axes raise the cost by 1 to 16 (4 on an exact parabola).
    """
    det = D[0, 0] * D[1, 1] - D[0, 1] ** 2
    for m in range(len(rivals)):
        dx, dy = rivals[m, 0] - place[0], rivals[m, 1] - place[1]
        distance2 = (D[1, 1] * dx * dx - 2.0 * D[0, 1] * dx * dy + D[0, 0] * dy * dy) / det
        if rivals[m, 2] < RIVAL_CHI2 and distance2 > 9.0:
            return False
    k, _, offset_information = priors
    angle = 0.5 * np.arctan2(2.0 * D[0, 1], D[0, 0] - D[1, 1])
    mean, spread = 0.5 * (D[0, 0] + D[1, 1]), np.hypot(0.5 * (D[0, 0] - D[1, 1]), D[0, 1])
    least = cost_at(means, table, place[0], place[1], k, offset_information)
    for m in range(4):
        turn = angle + 0.5 * np.pi * m
        reach = 2.0 * np.sqrt(max(mean + spread if m % 2 == 0 else mean - spread, 0.0))
        x, y = place[0] + reach * np.cos(turn), place[1] + reach * np.sin(turn)
        rise = cost_at(means, table, x, y, k, offset_information) - least
        if rise < 1.0 or rise > 16.0:
            return False
    return True


@njit(cache=True)
def posterior_moments(
    means: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    box: FloatArray,
    k: float,
    offset_information: float,
) -> tuple[FloatArray, FloatArray]:
    """Return mean (2,) and covariance (2, 2) of the static posterior ``exp(-C / 2)`` within a box.

    The grid is laid twice: over the whole box, then over the part that the posterior occupies. The
    place prior is uniform in the box; a cell's own extent is part of the covariance.
    """
    wide = costs_on(means, table, box, FINE, k, offset_information)
    support = _support_of(wide, box)
    costs = costs_on(means, table, support, FINE, k, offset_information)
    weights = np.exp(-0.5 * (costs - costs.min()))
    weights /= weights.sum()
    mean, D = np.zeros(2), np.zeros((2, 2))
    for a in range(FINE):
        for b in range(FINE):
            x, y = place_in(support, FINE, a, b)
            mean[0] += weights[a, b] * x
            mean[1] += weights[a, b] * y
    for a in range(FINE):
        for b in range(FINE):
            x, y = place_in(support, FINE, a, b)
            D[0, 0] += weights[a, b] * (x - mean[0]) ** 2
            D[0, 1] += weights[a, b] * (x - mean[0]) * (y - mean[1])
            D[1, 1] += weights[a, b] * (y - mean[1]) ** 2
    cell2 = max(support[4], support[5]) ** 2 / (3.0 * FINE * FINE)
    D[0, 0] += cell2
    D[1, 1] += cell2
    D[1, 0] = D[0, 1]
    return mean, D


@njit(cache=True)
def _support_of(costs: FloatArray, box: FloatArray) -> FloatArray:
    """Return the part of a box, one cell wider, where the cost is near its least value."""
    cells = len(costs)
    near = costs <= costs.min() + SUPPORT_CHI2
    first, last = np.full(2, cells), np.full(2, -1)
    for a in range(cells):
        for b in range(cells):
            if near[a, b]:
                first[0], last[0] = min(first[0], a), max(last[0], a)
                first[1], last[1] = min(first[1], b), max(last[1], b)
    half = np.empty(2)
    middle = np.empty(2)
    for axis in range(2):
        low, high = max(first[axis] - 1, 0), min(last[axis] + 1, cells - 1)
        half[axis] = box[4 + axis] * (high - low + 1) / cells
        middle[axis] = box[4 + axis] * ((low + high + 1) / cells - 1.0)
    x = box[0] + box[2] * middle[0] - box[3] * middle[1]
    y = box[1] + box[3] * middle[0] + box[2] * middle[1]
    return np.array([x, y, box[2], box[3], half[0], half[1]])
