"""Kernels that look at the whole cost surface: where its basins are, and what the posterior spans.

The level model is not convex: anchors in a row cannot tell the two sides of the row apart, and few
anchors leave several places that fit. So the cost of the static model, on the mean level per
anchor, is evaluated on a grid over the box in which the phone must be. Its local minima are the
starting points of Gauss-Newton, and where the minimum's own covariance does not tell the truth (see
`is_gaussian`), the moments of the posterior ``exp(-C / 2)`` on a grid do.

The grid lies along the principal axes of the anchors heard, so that a turned layout gives the same
answer, turned, and both sides of a row of anchors are treated alike.
"""

from typing import TypeAlias

import numpy as np
from numba import njit

from app.core.lateration.gauss_newton import Priors, Rows, minimise
from app.core.radio.path_loss import DZ2, INTERCEPT, SLOPE, X, Y, squared_distance
from app.core.types import FloatArray, IntArray

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


@njit(cache=True)
def box_around(places: FloatArray, margin_m: float) -> FloatArray:
    """Return centre (x, y), axis (x, y), half length, half width and margin of the box.

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
    half_a, half_b = along.max() - a + margin_m, across.max() - b + margin_m
    return np.array([c * a - s * b, s * a + c * b, c, s, half_a, half_b, margin_m])


@njit(cache=True)
def cost_at(surface: Surface, x_m: float, y_m: float) -> float:
    """Return the static cost at a place, at the phone offset that fits best there.

    A place outside the anchors' own box costs as a normal deviation of a third of the margin:
    people are where the anchors were put. Levels outweigh that, but when the phone's offset is
    unknown they do not tell a place inside the circle through the anchors from its inversion
    outside.
    """
    means, table, box, priors = surface
    k, _, offset_information = priors
    precision = means[3]
    offset: float = 0.0
    cost = _outside_cost(box, x_m, y_m)
    if offset_information < np.inf:
        weighted, total = 0.0, offset_information
        for j in range(len(precision)):
            weighted += precision[j] ** 2 * _residual(means, table, j, x_m, y_m)
            total += precision[j] ** 2
        offset = weighted / total
        cost += offset * offset * offset_information
    for j in range(len(precision)):
        z = abs(_residual(means, table, j, x_m, y_m) - offset) * precision[j]
        cost += z * z if z <= k else 2.0 * k * z - k * k
    return cost


@njit(cache=True)
def _outside_cost(box: FloatArray, x_m: float, y_m: float) -> float:
    """Return the place prior's cost."""
    along, across = in_box(box, x_m, y_m)
    far = max(abs(along) - box[4] + box[6], 0.0)
    wide = max(abs(across) - box[5] + box[6], 0.0)
    return float((far * far + wide * wide) * 9.0 / (box[6] * box[6]))


@njit(cache=True)
def in_box(box: FloatArray, x_m: float, y_m: float) -> tuple[float, float]:
    """Return a place (m) along and across the box, from its centre."""
    dx, dy = x_m - box[0], y_m - box[1]
    return box[2] * dx + box[3] * dy, box[2] * dy - box[3] * dx


@njit(cache=True)
def _residual(means: Rows, table: FloatArray, j: int, x_m: float, y_m: float) -> float:
    """Return measured minus expected level (dB) of mean j at a place."""
    i = means[0][j]
    d2 = squared_distance(x_m - table[i, X], y_m - table[i, Y], table[i, DZ2])
    return float(means[2][j] - table[i, INTERCEPT] + 0.5 * table[i, SLOPE] * np.log(d2))


@njit(cache=True)
def fill_costs(surface: Surface, grid: FloatArray, costs: FloatArray) -> None:
    """Fill costs (cells, cells) at the centres of a box's cells, the first index along its axis."""
    cells = len(costs)
    for a in range(cells):
        for b in range(cells):
            x, y = place_in(grid, cells, a, b)
            costs[a, b] = cost_at(surface, x, y)


@njit(cache=True)
def place_in(box: FloatArray, cells: int, a: int, b: int) -> tuple[float, float]:
    """Return the centre (m) of a cell of a box."""
    along = box[4] * ((2 * a + 1) / cells - 1.0)
    across = box[5] * ((2 * b + 1) / cells - 1.0)
    return box[0] + box[2] * along - box[3] * across, box[1] + box[3] * along + box[2] * across


@njit(cache=True)
def basins(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Return the minima of the static cost, (basins, p) with p 2 or 3, and their costs (basins,).

    Two passes: from the local minima of a coarse grid, then from the best minimum turned about its
    nearest anchor by quarter turns, because the basins around an anchor are closer than the cells.
    """
    box, priors = surface[2], surface[3]
    grid = np.empty((COARSE, COARSE))
    fill_costs(surface, box, grid)
    cells, count = local_minima(grid)
    states = np.zeros((count + 3, 3 if priors[2] < np.inf else 2))
    costs = np.empty(count + 3)
    for m in range(count):
        states[m, 0], states[m, 1] = place_in(box, COARSE, cells[m, 0], cells[m, 1])
    _descend(surface, states[:count], costs[:count])
    _quarter_turns(surface, states[np.argmin(costs[:count])], states[count:])
    _descend(surface, states[count:], costs[count:])
    return states, costs


@njit(cache=True)
def local_minima(costs: FloatArray) -> tuple[IntArray, int]:
    """Return the cells (row, column) that no neighbour undercuts, and their number."""
    cells = len(costs)
    found = np.empty((cells * cells, 2), np.int64)
    count = 0
    for a in range(cells):
        for b in range(cells):
            if costs[a, b] <= costs[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2].min():
                found[count, 0], found[count, 1] = a, b
                count += 1
    return found, count


@njit(cache=True)
def _descend(surface: Surface, states: FloatArray, costs: FloatArray) -> None:
    """Replace starts (n, p) by the minima reached from them, and fill their costs (n,)."""
    means, table, _, priors = surface
    for m in range(len(states)):
        states[m] = minimise(means, table, states[m], priors)[0]
        costs[m] = cost_at(surface, states[m, 0], states[m, 1])


@njit(cache=True)
def _quarter_turns(surface: Surface, state: FloatArray, turned: FloatArray) -> None:
    """Fill (3, p) with a state turned about its nearest anchor by one, two and three quarters."""
    heard, table = surface[0][0], surface[1]
    nearest, dx, dy = 0, np.inf, np.inf
    for i in heard:
        if np.hypot(state[0] - table[i, X], state[1] - table[i, Y]) < np.hypot(dx, dy):
            nearest, dx, dy = i, state[0] - table[i, X], state[1] - table[i, Y]
    for m in range(3):
        dx, dy = -dy, dx
        turned[m] = state
        turned[m, 0], turned[m, 1] = table[nearest, X] + dx, table[nearest, Y] + dy


@njit(cache=True)
def is_gaussian(
    surface: Surface, place: FloatArray, D: FloatArray, found: tuple[FloatArray, FloatArray]
) -> bool:
    """Return whether the covariance D (2, 2) of the best place tells what the surface says.

    It does if no rival basin outside its 3-sigma ellipse is plausible, and if two standard
    deviations along its axes raise the cost by 1 to 16 (4 on an exact parabola).
    """
    det = D[0, 0] * D[1, 1] - D[0, 1] ** 2
    states, costs = found
    for m in range(len(states)):
        dx, dy = states[m, 0] - place[0], states[m, 1] - place[1]
        distance2 = (D[1, 1] * dx * dx - 2.0 * D[0, 1] * dx * dy + D[0, 0] * dy * dy) / det
        if costs[m] < costs.min() + RIVAL_CHI2 and distance2 > 9.0:
            return False
    angle = 0.5 * np.arctan2(2.0 * D[0, 1], D[0, 0] - D[1, 1])
    mean, spread = 0.5 * (D[0, 0] + D[1, 1]), np.hypot(0.5 * (D[0, 0] - D[1, 1]), D[0, 1])
    least = cost_at(surface, place[0], place[1])
    for m in range(4):
        turn = angle + 0.5 * np.pi * m
        reach = 2.0 * np.sqrt(max(mean + spread if m % 2 == 0 else mean - spread, 0.0))
        x, y = place[0] + reach * np.cos(turn), place[1] + reach * np.sin(turn)
        rise = cost_at(surface, x, y) - least
        if rise < LEAST_RISE or rise > MOST_RISE:
            return False
    return True


@njit(cache=True)
def posterior_moments(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Return mean (2,) and covariance (2, 2) of the static posterior ``exp(-C / 2)`` within a box.

    The grid is laid twice: over the whole box, then over the part that the posterior occupies. The
    place prior is that of `cost_at`; a cell's own extent is part of the covariance.
    """
    costs = np.empty((FINE, FINE))
    fill_costs(surface, surface[2], costs)
    support = _support_of(costs, surface[2])
    fill_costs(surface, support, costs)
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
    bound = costs.min() + SUPPORT_CHI2
    first, last = np.array([cells, cells]), np.array([-1, -1])
    for a in range(cells):
        for b in range(cells):
            if costs[a, b] <= bound:
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
    return np.array([x, y, box[2], box[3], half[0], half[1], 0.0])
