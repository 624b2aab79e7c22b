"""Windowed least squares in the level domain: a fix from the levels of about two seconds.

Two models of the phone within the window, after Grinyak, Grinyak, Tsybanov (The Territory of New
Opportunities 10(2), 2018): static ``s = (x, y)`` and kinematic ``s = (x, y, vx, vy)`` at a
reference time ``t*``. The equations are in `app.core.lateration.gauss_newton`.

Covariance
----------
``D = (H' W Q^-1 H)^-1`` at the solution, ``W`` the Huber weights. On normal noise the mean weight
is 0.956 and the estimator's efficiency 0.95, so D is what the estimate really scatters by; a
reading held for an outlier counts for less, as it should. Where the cost surface is not a parabola
around the minimum (anchors in a row, few readings, the minimum at the edge of the search box) the
fix is the mean and the covariance of the posterior instead, `app.core.lateration.surface`: anchors
in a row give a point on their line and a covariance that reaches both mirror images. If even that
is wider than ``max_sigma_m``, there is no fix.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numba import njit

from app.core.lateration.gauss_newton import Priors, Rows, inverse, minimise
from app.core.lateration.surface import (
    Surface,
    basins,
    box_around,
    inside,
    is_gaussian,
    posterior_moments,
)
from app.core.params import LaterationParams
from app.core.radio.path_loss import SIGMA, LevelModel, X, Y
from app.core.radio.windows import Window
from app.core.types import Fix, FloatArray, IntArray, Method, NoFix, NoFixReason, Used

Heard: TypeAlias = tuple[IntArray, FloatArray, FloatArray]
"""Anchor, tau (s) and level (dBm) of each reading, sorted by anchor."""

WALKING_SPEED_MPS = 1.3
"""Usual speed of a person on foot (indoors 1.0 to 1.5). Where no velocity can be estimated, a
moving phone may have gone this far, in any direction, between the middle of the window and t*."""

HUBER_ROUNDS = 8
"""Reweightings of an anchor's mean level; each takes away most of what outliers still pull."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A fix and what else the solution tells.

    Attributes
    ----------
    covariance : (n, n)
        D of x, y (n = 2), and of vx, vy where the fix has a velocity (n = 4).
    velocity_chi2
        ``v' D_vv^-1 v`` of the kinematic model: at rest chi-square with 2 degrees of freedom.
    offset_db
        The phone's level offset, if it was unknown.
    linearised
        Whether mean and covariance are Gauss-Newton's; False: moments of the posterior.
    """

    fix: Fix
    covariance: FloatArray
    velocity_chi2: float | None
    offset_db: float | None
    linearised: bool


def estimate(
    window: Window,
    model: LevelModel,
    at_s: float,
    *,
    kinematic: bool,
    params: LaterationParams,
    area_m: FloatArray | None = None,
) -> Estimate | NoFix:
    """Return where the phone was at a time, from the levels of a window.

    Parameters
    ----------
    window
        Readings of anchors of one floor (see `app.core.radio.windows.of_anchors`).
    model
        Level models; ``window.anchor_index`` points into it.
    at_s
        The reference time t*; the static model only stamps its fix with it.
    kinematic
        Whether to estimate a velocity. Wanted for a phone that moves, and only then: the velocity
        of a phone at rest doubles the error of its position.
    area_m : (n, 2)
        Corners of where phones can be: the box is laid around them, instead of around the anchors
        heard. A weak signal leaves much of that open, so it helps most where few are heard.

    Returns
    -------
    Estimate or NoFix
        `NOTHING_HEARD`, `TOO_FEW_TRANSMITTERS`, or `DEGENERATE_GEOMETRY` for a place known worse
        than ``max_sigma_m``.
    """
    heard = window.anchors_heard
    if heard == 0:
        return NoFix(at_s, NoFixReason.NOTHING_HEARD)
    if heard < params.min_anchors:
        return NoFix(at_s, NoFixReason.TOO_FEW_TRANSMITTERS)
    readings, means = _weighed(
        (window.anchor_index, window.time_s - at_s, window.rssi_dbm),
        model.table,
        params.huber_k,
        params.shadowing_correlation,
    )
    if area_m is None:
        area_m = model.table[means[0], X : Y + 1]
    box = box_around(area_m, params.search_margin_m)
    surface = (means, model.table, box, _priors(params))
    state, D, linearised = _solve(readings, surface, kinematic)
    if not _worst_variance(D) <= params.max_sigma_m**2:
        return NoFix(at_s, NoFixReason.DEGENERATE_GEOMETRY)
    has_velocity = kinematic and linearised
    fix = Fix(
        time_s=at_s,
        x_m=float(state[0]),
        y_m=float(state[1]),
        covariance_m2=(float(D[0, 0]), float(D[0, 1]), float(D[1, 1])),
        method=Method.LATERATION,
        used=Used(beacons=heard),
        velocity_mps=(float(state[2]), float(state[3])) if has_velocity else None,
    )
    return Estimate(
        fix,
        covariance=D[:4, :4] if has_velocity else D[:2, :2],
        velocity_chi2=_chi2(state[2:4], D[2:4, 2:4]) if has_velocity else None,
        offset_db=float(state[-1]) if len(state) % 2 else None,
        linearised=linearised,
    )


def _priors(params: LaterationParams) -> Priors:
    """Return Huber's k and the prior informations of velocity and offset."""
    velocity, offset = params.velocity_prior_mps, params.offset_prior_db
    return (
        params.huber_k,
        0.0 if velocity is None else velocity**-2,
        np.inf if offset == 0.0 else offset**-2,
    )


def _worst_variance(D: FloatArray) -> float:
    """Return the larger eigenvalue of the position's covariance."""
    middle, half = 0.5 * (D[0, 0] + D[1, 1]), 0.5 * (D[0, 0] - D[1, 1])
    return float(middle + np.hypot(half, D[0, 1]))


def _chi2(v: FloatArray, D: FloatArray) -> float:
    """Return ``v' D^-1 v`` of two components."""
    det = D[0, 0] * D[1, 1] - D[0, 1] ** 2
    return float((D[1, 1] * v[0] ** 2 - 2.0 * D[0, 1] * v[0] * v[1] + D[0, 0] * v[1] ** 2) / det)


def _solve(
    readings: Rows, surface: Surface, kinematic: bool
) -> tuple[FloatArray, FloatArray, bool]:
    """Return state (p,), covariance (p, p) and whether they are Gauss-Newton's."""
    means, table, box, priors = surface
    found = basins(surface)
    static, _, A = minimise(means, table, found[0][np.argmin(found[1])], priors)
    D = inverse(A)
    if D is not None and inside(box, static) and is_gaussian(surface, static, D, found):
        state, A = _refined(readings, table, static, kinematic, priors)
        D = inverse(A)
        if D is not None and inside(box, state):
            return state, D, True
    mean, D = posterior_moments(surface)
    if kinematic:
        reach2 = 0.5 * (WALKING_SPEED_MPS * float(readings[1].mean())) ** 2
        D += reach2 * np.eye(2)
    return mean, D, False


def _weighed(heard: Heard, table: FloatArray, k: float, correlation: float) -> tuple[Rows, Rows]:
    """Return the readings with their precisions, and their robust means per anchor with theirs.

    M readings with correlation rho count as ``M / (1 + rho (M - 1))`` independent ones (Kish's
    design effect); each gets its share of that.
    """
    anchor, tau_s, rssi_dbm = heard
    bounds = np.flatnonzero(np.concatenate(([True], anchor[1:] != anchor[:-1], [True])))
    count = bounds[1:] - bounds[:-1]
    which = anchor[bounds[:-1]]
    sigma_db = table[which, SIGMA]
    share = 1.0 / (sigma_db * np.sqrt(1.0 + correlation * (count - 1)))
    level_dbm = _huber_means(rssi_dbm, bounds, k * sigma_db)
    means = (which, np.zeros(len(which)), level_dbm, share * np.sqrt(count))
    return (anchor, tau_s, rssi_dbm, np.repeat(share, count)), means


@njit(cache=True)
def _huber_means(values: FloatArray, bounds: IntArray, limit: FloatArray) -> FloatArray:
    """Return the mean of each group ``values[bounds[i]:bounds[i + 1]]``, robustly.

    A value counts less the farther, beyond its group's limit, it is from the mean.
    """
    means = np.empty(len(limit))
    for group in range(len(limit)):
        members = range(bounds[group], bounds[group + 1])
        mean = 0.0
        for j in members:
            mean += values[j] / len(members)
        for _ in range(HUBER_ROUNDS):
            weighted, total = 0.0, 0.0
            for j in members:
                weight = limit[group] / max(abs(values[j] - mean), limit[group])
                weighted += weight * values[j]
                total += weight
            mean = weighted / total
        means[group] = mean
    return means


def _refined(
    readings: Rows,
    table: FloatArray,
    static: FloatArray,
    kinematic: bool,
    priors: Priors,
) -> tuple[FloatArray, FloatArray]:
    """Return state and information from all readings one by one, started at the static solution."""
    velocity = np.zeros(2 if kinematic else 0)
    start = np.concatenate((static[:2], velocity, static[2:]))
    state, _, A = minimise(readings, table, start, priors)
    return state, A
