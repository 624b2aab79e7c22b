"""What a layout of anchors promises on a floor: predicted error cell by cell, anchor by anchor.

Equation
--------
With ``h_i`` the gradient of anchor i's level over its shadowing, ``J(c) = sum h_i h_i'`` over the
anchors heard in cell ``c`` (`app.core.radio.walls`) and ``f`` the factor of the window's schedule
(`Schedule.position_factor`), the covariance of a fix in the cell is ``D = f J^-1`` and
``sigma_xy = sqrt(tr D)``. It is infinite where what is heard leaves a direction open, and where
fewer anchors are heard than a fix takes: two leave two places, mirror images of each other, which
``D``, a matter of the surroundings of one place, does not show.

Layouts are compared by the mean over the cells of ``tr D``. To stay finite where there is no fix,
it is taken with a weak prior, ``D' = (J / f + I / s^2)^-1``: where there is a fix, ``D'`` is as
good as ``D``; each open direction of a cell costs ``s^2``, more than all else together, and so does
each anchor that a fix lacks.

Source: Grinyak, Grinyak, Tsybanov, The Territory of New Opportunities 10(2), 2018 (the matrix D);
the prior is the usual way around a singular information matrix in the design of experiments.
"""

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.lateration.predicted import SINGULAR, Schedule
from app.core.params import LaterationParams
from app.core.radio.path_loss import DZ2, SIGMA, SLOPE, LevelModel, X, Y, squared_distance
from app.core.radio.walls import NO_WALLS, HearingParams, heard
from app.core.types import BoolArray, FloatArray, IntArray

PRIOR_RADII = 100.0
"""``s`` in root mean square radii of the floor: changes a sigma of a tenth of it by 1 in 10^6."""


HEARD = 3
"""Column of an information array that counts the anchors heard."""

Scale: TypeAlias = tuple[float, float, float]
"""Kernels' f, prior (1/m^2) and number of anchors that a fix takes."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The cells of a floor where people walk, and the walls between them.

    Attributes
    ----------
    x_m, y_m : (cells,)
        Centres, metres.
    walls : (walls, 5)
        See `app.core.radio.walls`.
    """

    x_m: FloatArray
    y_m: FloatArray
    walls: FloatArray = field(default_factory=NO_WALLS.copy)

    @property
    def prior_m2(self) -> float:
        """``s^2`` of the weak prior that compares layouts."""
        radius2_m2 = float(np.var(self.x_m) + np.var(self.y_m))
        return PRIOR_RADII**2 * max(radius2_m2, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted error per cell.

    Attributes
    ----------
    static_m, kinematic_m : (cells,)
        sigma_xy of a fix at rest and of one with an unknown velocity; infinite: no fix there.
    in_range : (cells,)
        Number of anchors heard.
    """

    static_m: FloatArray
    kinematic_m: FloatArray
    in_range: IntArray


@dataclass(frozen=True, slots=True)
class FixRule:
    """What a fix takes and what it is worth.

    Attributes
    ----------
    covariance_scale
        f, see `Schedule.position_factor`.
    min_anchors
        Fewer anchors heard are no fix (as `LaterationParams.min_anchors`).
    """

    covariance_scale: float
    min_anchors: int = LaterationParams().min_anchors


def predict(
    ground: Ground, model: LevelModel, schedule: Schedule, hearing: HearingParams
) -> Prediction:
    """Return the predicted error of a layout, with the usual number of anchors for a fix."""
    audible = heard(model, ground.x_m, ground.y_m, ground.walls, hearing)
    static, kinematic = (
        FixRule(schedule.position_factor(kinematic=moving)) for moving in (False, True)
    )
    return prediction(information(model, ground, audible), static, kinematic)


def prediction(J: FloatArray, static: FixRule, kinematic: FixRule) -> Prediction:
    """Return the predicted error where the information is known.

    Parameters
    ----------
    J : (cells, 4)
        See `information`.
    """
    return Prediction(
        np.sqrt(traces(J, static, 0.0)),
        np.sqrt(traces(J, kinematic, 0.0)),
        J[:, HEARD].astype(np.int64),
    )


def information(model: LevelModel, ground: Ground, audible: BoolArray) -> FloatArray:
    """Return J of one epoch in each cell.

    Parameters
    ----------
    audible : (anchors, cells)
        Whether an anchor is heard.

    Returns
    -------
    (cells, 4)
        ``J_xx, J_xy, J_yy`` (1/m^2), and how many anchors are heard. It adds up over anchors.
    """
    J = np.zeros((len(ground.x_m), 4))
    for row, of_one in zip(model.table, audible, strict=True):
        _add_information(row, (ground.x_m, ground.y_m), of_one, J)
    return J


def traces(J: FloatArray, rule: FixRule, prior_m2: float) -> FloatArray:
    """Return ``tr (J / f + I / s^2)^-1`` in each cell, m^2, with `prior_m2` for what a fix lacks.

    Parameters
    ----------
    J : (cells, 4)
        Information of one epoch, see `information`.
    prior_m2
        s^2; 0: without a prior, infinite where there is no fix.
    """
    return np.asarray(_traces(J, scale_of(rule, prior_m2)))


def leave_one_out_m2(
    model: LevelModel, ground: Ground, audible: BoolArray, rule: FixRule
) -> FloatArray:
    """Return `traces`, without a prior, of the layout without each of its anchors in turn.

    What the others tell is added up from both ends of the list, never taken off the whole: beside
    an anchor the difference would be rounding.

    Returns
    -------
    (anchors, cells)
    """
    places = (ground.x_m, ground.y_m)
    return np.asarray(_leave_one_out(model.table, places, audible, scale_of(rule, 0.0)))


def scale_of(rule: FixRule, prior_m2: float) -> Scale:
    """Return a rule and a prior in the form that kernels take."""
    prior_per_m2 = 1.0 / prior_m2 if prior_m2 > 0.0 else 0.0
    return rule.covariance_scale, prior_per_m2, float(rule.min_anchors)


@register_jitable
def gradient(row: FloatArray, x_m: float, y_m: float) -> tuple[float, float]:
    """Return an anchor's level gradient at a place over its shadowing, 1/m (kernels)."""
    dx, dy = x_m - row[X], y_m - row[Y]
    slope = -row[SLOPE] / (row[SIGMA] * squared_distance(dx, dy, row[DZ2]))
    return slope * dx, slope * dy


@register_jitable
def trace(xx: float, xy: float, yy: float, anchors: int, scale: Scale) -> float:
    """Return ``tr (J / f + I prior)^-1``, and a prior's variance for each lacking anchor."""
    f, prior, least = scale
    lacking = max(least - anchors, 0.0)
    a, b, c = xx / f + prior, xy / f, yy / f + prior
    det = a * c - b * b
    if prior > 0.0:
        # Both eigenvalues are at least the prior's: less is rounding.
        return float((a + c) / max(det, prior * prior) + lacking / prior)
    if lacking > 0.0 or det <= SINGULAR * (a + c) * (a + c):
        return np.inf
    return float((a + c) / det)


@njit(cache=True, nogil=True)
def _add_information(
    row: FloatArray, places: tuple[FloatArray, FloatArray], audible: BoolArray, J: FloatArray
) -> None:
    x, y = places
    for c in range(len(x)):
        if audible[c]:
            hx, hy = gradient(row, x[c], y[c])
            J[c, 0] += hx * hx
            J[c, 1] += hx * hy
            J[c, 2] += hy * hy
            J[c, HEARD] += 1.0


@njit(cache=True, nogil=True)
def _traces(J: FloatArray, scale: Scale) -> FloatArray:
    out = np.empty(len(J))
    for c in range(len(J)):
        out[c] = trace(J[c, 0], J[c, 1], J[c, 2], int(J[c, HEARD]), scale)
    return out


@njit(cache=True, nogil=True)
def _leave_one_out(
    table: FloatArray,
    places: tuple[FloatArray, FloatArray],
    audible: BoolArray,
    scale: Scale,
) -> FloatArray:
    x, y = places
    n = len(table)
    out = np.empty((n, len(x)))
    after = np.zeros((n + 1, 3))
    for c in range(len(x)):
        for i in range(n - 1, -1, -1):
            hx, hy = gradient(table[i], x[c], y[c]) if audible[i, c] else (0.0, 0.0)
            after[i, 0] = after[i + 1, 0] + hx * hx
            after[i, 1] = after[i + 1, 1] + hx * hy
            after[i, 2] = after[i + 1, 2] + hy * hy
        total = audible[:, c].sum()
        xx = xy = yy = 0.0
        for i in range(n):
            hx, hy = gradient(table[i], x[c], y[c]) if audible[i, c] else (0.0, 0.0)
            without = (xx + after[i + 1, 0], xy + after[i + 1, 1], yy + after[i + 1, 2])
            others = total - audible[i, c]
            out[i, c] = trace(without[0], without[1], without[2], others, scale)
            xx, xy, yy = xx + hx * hx, xy + hx * hy, yy + hy * hy
    return out
