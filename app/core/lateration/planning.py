"""What a layout of anchors promises on a floor: predicted error cell by cell, anchor by anchor.

Equation
--------
With ``h_i`` the gradient of anchor i's level over its shadowing, ``J(c) = sum h_i h_i'`` over the
anchors heard in cell ``c`` (`app.core.radio.walls`) and ``f`` the factor of the window's schedule
(`Schedule.position_factor`), the covariance of a fix in the cell is ``D = f J^-1`` and
``sigma_xy = sqrt(tr D)``; infinite where what is heard leaves a direction open.

Layouts are compared by the mean over the cells of ``tr D``. To stay finite where there is no fix,
it is taken with a weak prior, ``D' = (J / f + I / s^2)^-1``: where a fix is any good, ``D'`` is
``D``, and each open direction of a cell costs ``s^2``, more than all else together.

Source: Grinyak, Grinyak, Tsybanov, The Territory of New Opportunities 10(2), 2018 (the matrix D);
the prior is the usual way around a singular information matrix in the design of experiments.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.lateration.predicted import SINGULAR, Schedule
from app.core.radio.path_loss import DZ2, SIGMA, SLOPE, LevelModel, X, Y, squared_distance
from app.core.radio.walls import NO_WALLS, HearingParams, heard
from app.core.types import BoolArray, FloatArray, IntArray

PRIOR_RADII = 100.0
"""``s`` in root mean square radii of the floor: changes a sigma of a tenth of it by 1 in 10^6."""


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


def predict(
    ground: Ground, model: LevelModel, schedule: Schedule, hearing: HearingParams
) -> Prediction:
    """Return the predicted error of a layout."""
    audible = heard(model, ground.x_m, ground.y_m, ground.walls, hearing)
    return prediction(information(model, ground, audible), audible, schedule)


def prediction(J: FloatArray, audible: BoolArray, schedule: Schedule) -> Prediction:
    """Return the predicted error where information and anchors heard are known.

    Parameters
    ----------
    J : (cells, 3)
        See `information`.
    audible : (anchors, cells)
    """
    unit_m2 = traces(J, 1.0, 0.0)
    static, kinematic = (
        np.sqrt(schedule.position_factor(kinematic=moving) * unit_m2) for moving in (False, True)
    )
    return Prediction(static, kinematic, audible.sum(axis=0))


def information(model: LevelModel, ground: Ground, audible: BoolArray) -> FloatArray:
    """Return J of one epoch in each cell.

    Parameters
    ----------
    audible : (anchors, cells)
        Whether an anchor is heard.

    Returns
    -------
    (cells, 3)
        ``J_xx, J_xy, J_yy``, 1/m^2.
    """
    J = np.zeros((len(ground.x_m), 3))
    for row, of_one in zip(model.table, audible, strict=True):
        _add_information(row, (ground.x_m, ground.y_m), of_one, J)
    return J


def traces(J: FloatArray, covariance_scale: float, prior_m2: float) -> FloatArray:
    """Return ``tr (J / f + I / s^2)^-1`` in each cell, m^2.

    Parameters
    ----------
    J : (cells, 3)
        Information of one epoch.
    covariance_scale
        f, what `Schedule.position_factor` gives.
    prior_m2
        s^2; 0: without a prior, infinite where J is singular.
    """
    prior = 1.0 / prior_m2 if prior_m2 > 0.0 else 0.0
    return np.asarray(_traces(J, covariance_scale, prior))


def leave_one_out_m2(
    model: LevelModel, ground: Ground, audible: BoolArray, covariance_scale: float, prior_m2: float
) -> FloatArray:
    """Return `traces` of the layout without each of its anchors in turn, (anchors, cells).

    What the others tell is added up from both ends of the list, never taken off the whole: beside
    an anchor the difference would be rounding.
    """
    prior = 1.0 / prior_m2 if prior_m2 > 0.0 else 0.0
    places = (ground.x_m, ground.y_m)
    return np.asarray(_leave_one_out(model.table, places, audible, (covariance_scale, prior)))


@register_jitable
def gradient(row: FloatArray, x_m: float, y_m: float) -> tuple[float, float]:
    """Return an anchor's level gradient at a place over its shadowing, 1/m (kernels)."""
    dx, dy = x_m - row[X], y_m - row[Y]
    slope = -row[SLOPE] / (row[SIGMA] * squared_distance(dx, dy, row[DZ2]))
    return slope * dx, slope * dy


@register_jitable
def trace(xx: float, xy: float, yy: float, covariance_scale: float, prior_per_m2: float) -> float:
    """Return ``tr (J / f + I prior)^-1`` (kernels)."""
    a, c = xx / covariance_scale + prior_per_m2, yy / covariance_scale + prior_per_m2
    b = xy / covariance_scale
    det = a * c - b * b
    if prior_per_m2 > 0.0:
        # Both eigenvalues are at least the prior's: less is rounding.
        det = max(det, prior_per_m2 * prior_per_m2)
    elif det <= SINGULAR * (a + c) * (a + c):
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


@njit(cache=True, nogil=True)
def _traces(J: FloatArray, factor: float, prior: float) -> FloatArray:
    out = np.empty(len(J))
    for c in range(len(J)):
        out[c] = trace(J[c, 0], J[c, 1], J[c, 2], factor, prior)
    return out


@njit(cache=True, nogil=True)
def _leave_one_out(
    table: FloatArray,
    places: tuple[FloatArray, FloatArray],
    audible: BoolArray,
    scale: tuple[float, float],
) -> FloatArray:
    x, y = places
    factor, prior = scale
    n = len(table)
    out = np.empty((n, len(x)))
    after = np.zeros((n + 1, 3))
    for c in range(len(x)):
        for i in range(n - 1, -1, -1):
            hx, hy = gradient(table[i], x[c], y[c]) if audible[i, c] else (0.0, 0.0)
            after[i, 0] = after[i + 1, 0] + hx * hx
            after[i, 1] = after[i + 1, 1] + hx * hy
            after[i, 2] = after[i + 1, 2] + hy * hy
        xx = xy = yy = 0.0
        for i in range(n):
            hx, hy = gradient(table[i], x[c], y[c]) if audible[i, c] else (0.0, 0.0)
            without = (xx + after[i + 1, 0], xy + after[i + 1, 1], yy + after[i + 1, 2])
            out[i, c] = trace(without[0], without[1], without[2], factor, prior)
            xx, xy, yy = xx + hx * hx, xy + hx * hy, yy + hy * hy
    return out
