"""Which anchors are heard where: the level behind walls against a hearing threshold.

Equation
--------
Every wall ``w`` that the straight line from anchor to phone crosses takes its loss off the level
(multi-wall model)::

    u(p) = u* - 10 n log10(d / d*) - sum_w L_w,      heard where  u(p) >= u_min  and  d_xy <= reach

A wall changes only *which* anchors are heard. The loss is the same on both sides of a step, so the
slope of a level over the place, and with it what one reading tells, stays that of the log-distance
model. The line is drawn in the plane: walls reach from floor to ceiling. An anchor that hangs in a
wall is heard on both sides of it. Losses add up without bound, so behind many walls, where the way
around them is louder, the model is pessimistic.

A line is tested only against walls that the anchor sees in its direction: walls are sorted into
`SECTORS` around each anchor.

Source: Motley and Keenan 1988; the multi-wall model of COST 231, final report 1999, ch. 4.7,
without its floor term.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.radio.path_loss import (
    DZ2,
    INTERCEPT,
    SLOPE,
    LevelModel,
    X,
    Y,
    squared_distance,
)
from app.core.types import BoolArray, FloatArray, IntArray

# Columns of a wall's row: its ends, metres, and what it takes from a level, dB.
X0, Y0, X1, Y1, LOSS = range(5)

NO_WALLS: FloatArray = np.empty((0, 5))

SECTORS = 256
"""Directions around an anchor: 1.4 degrees are less than most walls span, and few to go through."""

MAX_CROSSING_TESTS = 300_000_000
"""Tests of a line against a wall in one call: about a second."""


class TooManyWallsError(ValueError):
    """There are too many walls for so many anchors and places."""


@dataclass(frozen=True, slots=True)
class HearingParams:
    """When an anchor counts as heard.

    Attributes
    ----------
    threshold_dbm
        Weakest level that is reported: phones report advertisements down to -95 to -100 dBm.
    reach_m
        Anchors farther than this, in the plane, are not used at all.
    """

    threshold_dbm: float = -95.0
    reach_m: float = np.inf


@register_jitable
def crosses(x_m: float, y_m: float, u_m: float, v_m: float, wall: FloatArray) -> bool:
    """Return whether the segment (x, y)-(u, v) passes a wall: the ends lie on either side."""
    wx, wy = wall[X1] - wall[X0], wall[Y1] - wall[Y0]
    side_p = wx * (y_m - wall[Y0]) - wy * (x_m - wall[X0])
    side_q = wx * (v_m - wall[Y0]) - wy * (u_m - wall[X0])
    dx, dy = u_m - x_m, v_m - y_m
    side_a = dx * (wall[Y0] - y_m) - dy * (wall[X0] - x_m)
    side_b = dx * (wall[Y1] - y_m) - dy * (wall[X1] - x_m)
    return bool(side_p * side_q < 0.0 and side_a * side_b < 0.0)


def heard(
    model: LevelModel, x_m: FloatArray, y_m: FloatArray, walls: FloatArray, params: HearingParams
) -> BoolArray:
    """Return whether each anchor is heard at each place.

    Parameters
    ----------
    x_m, y_m : (places,)
    walls : (walls, 5)
        Ends (m) and loss (dB) of each wall.

    Returns
    -------
    (anchors, places)

    Raises
    ------
    TooManyWallsError
        Beyond `MAX_CROSSING_TESTS`.
    """
    found = np.empty((model.anchors, len(x_m)), dtype=np.bool_)
    bounds, tests = (params.threshold_dbm, params.reach_m), 0
    for row, range_m, audible in zip(model.table, _ranges_m(model, params), found, strict=True):
        near = walls[_within(walls, row[X], row[Y], range_m)]
        left = MAX_CROSSING_TESTS - tests
        tests += _heard_of_one(row, (x_m, y_m), near, (*bounds, left), audible)
        if tests > MAX_CROSSING_TESTS:
            msg = f"{len(walls)} walls are too many for so many anchors and places"
            raise TooManyWallsError(msg)
    return found


def _ranges_m(model: LevelModel, params: HearingParams) -> FloatArray:
    """Return how far each anchor is heard without walls, (anchors,)."""
    margin_db = model.table[:, INTERCEPT] - params.threshold_dbm
    # Beyond any floor; keeps a steep exponent of a loud anchor from overflowing.
    nepers = np.minimum(margin_db / model.table[:, SLOPE], 30.0)
    return np.asarray(np.minimum(np.exp(nepers), params.reach_m))


def _within(walls: FloatArray, x_m: float, y_m: float, range_m: float) -> BoolArray:
    """Return which walls' bounding boxes come within a range of a place."""
    dx = np.maximum(np.minimum(walls[:, X0], walls[:, X1]) - x_m, 0.0)
    dx = np.maximum(dx, x_m - np.maximum(walls[:, X0], walls[:, X1]))
    dy = np.maximum(np.minimum(walls[:, Y0], walls[:, Y1]) - y_m, 0.0)
    dy = np.maximum(dy, y_m - np.maximum(walls[:, Y0], walls[:, Y1]))
    return np.asarray(np.hypot(dx, dy) <= range_m)


@njit(cache=True, nogil=True)
def _heard_of_one(
    row: FloatArray,
    places: tuple[FloatArray, FloatArray],
    walls: FloatArray,
    bounds: tuple[float, float, int],
    audible: BoolArray,
) -> int:
    """Fill whether an anchor (row of `LevelModel.table`) is heard; return the tests it took.

    The last of the bounds is the number of tests that it gives up after.
    """
    x, y = places
    threshold, reach, most = bounds
    first, listed = _by_sector(row[X], row[Y], walls)
    tests = 0
    for c in range(len(x)):
        dx, dy = x[c] - row[X], y[c] - row[Y]
        squared = squared_distance(dx, dy, row[DZ2])
        margin = row[INTERCEPT] - threshold - 0.5 * row[SLOPE] * np.log(squared)
        if len(walls) > 0 and margin >= 0.0:
            sector = _sector(dx, dy)
            for i in range(first[sector], first[sector + 1]):
                tests += 1
                wall = walls[listed[i]]
                if crosses(x[c], y[c], row[X], row[Y], wall):
                    margin -= wall[LOSS]
                    if margin < 0.0:
                        break
        audible[c] = margin >= 0.0 and dx * dx + dy * dy <= reach * reach
        if tests > most:
            break
    return tests


@register_jitable
def _sector(dx: float, dy: float) -> int:
    """Return the sector of a direction, 0 to SECTORS - 1."""
    turn = 0.5 + np.arctan2(dy, dx) / (2.0 * np.pi)
    return min(int(turn * SECTORS), SECTORS - 1)


@register_jitable
def _by_sector(x: float, y: float, walls: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the walls seen from a place in each sector: first index per sector, and the list.

    The sectors of a wall are those from one end on, counter-clockwise, to the other, which is less
    than half a turn ahead, and one more on either side against rounding. A place in a wall sees it
    the one way or the other, which does not matter: no line from there crosses it.
    """
    start = np.empty(len(walls), dtype=np.int64)
    count = np.empty(len(walls), dtype=np.int64)
    first = np.zeros(SECTORS + 1, dtype=np.int64)
    for w in range(len(walls)):
        ax, ay, bx, by = walls[w, X0] - x, walls[w, Y0] - y, walls[w, X1] - x, walls[w, Y1] - y
        a, b = _sector(ax, ay), _sector(bx, by)
        if ax * by - ay * bx < 0.0:
            a, b = b, a
        ahead = (b - a) % SECTORS
        start[w], count[w] = a - 1 + SECTORS, min(ahead + 3, SECTORS)
        for k in range(count[w]):
            first[(start[w] + k) % SECTORS + 1] += 1
    for s in range(SECTORS):
        first[s + 1] += first[s]
    listed = np.empty(first[SECTORS], dtype=np.int64)
    filled = first.copy()
    for w in range(len(walls)):
        for k in range(count[w]):
            s = (start[w] + k) % SECTORS
            listed[filled[s]] = w
            filled[s] += 1
    return first, listed
