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

import numpy as np
from numba import njit

from app.core.lateration.gauss_newton import Priors, Rows, inverse, minimise
from app.core.lateration.surface import basins, box_around, in_box, is_gaussian, posterior_moments
from app.core.params import LaterationParams
from app.core.radio.path_loss import SIGMA, LevelModel, X, Y
from app.core.radio.windows import Window
from app.core.types import Fix, FloatArray, IntArray, Method, NoFix, NoFixReason, Used

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
    velocity_chi2
        ``v' D_vv^-1 v`` of the kinematic model: at rest chi-square with 2 degrees of freedom.
    offset_db
        The phone's level offset, if it was unknown.
    linearised
        Whether mean and covariance are Gauss-Newton's; False: moments of the posterior.
    """

    fix: Fix
    velocity_chi2: float | None
    offset_db: float | None
    linearised: bool


def estimate(
    window: Window, model: LevelModel, at_s: float, *, kinematic: bool, params: LaterationParams
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
    state, D, linearised = _solve(
        (window.anchor_index, window.time_s - at_s, window.rssi_dbm),
        model.table,
        kinematic,
        _priors(params),
        params.shadowing_correlation,
        params.search_margin_m,
    )
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


@njit(cache=True)
def _solve(
    heard: tuple[IntArray, FloatArray, FloatArray],
    table: FloatArray,
    kinematic: bool,
    priors: Priors,
    correlation: float,
    margin_m: float,
) -> tuple[FloatArray, FloatArray, bool]:
    """Return state (p,), covariance (p, p) and whether they are Gauss-Newton's.

    ``heard`` is anchor, tau (s) and level (dBm) of each reading, sorted by anchor.
    """
    readings, means = _weighed(heard, table, priors[0], correlation)
    places = np.empty((len(means[0]), 2))
    for j, i in enumerate(means[0]):
        places[j, 0], places[j, 1] = table[i, X], table[i, Y]
    surface = (means, table, box_around(places, margin_m), priors)
    found = basins(surface)
    static, _, A = minimise(means, table, found[0][np.argmin(found[1])], priors)
    regular, D = inverse(A)
    if (
        regular
        and _inside(surface[2], static)
        and is_gaussian(surface, static[:2], D[:2, :2], found)
    ):
        state, A = _refined(readings, table, static, kinematic, priors)
        regular, D = inverse(A)
        if regular and _inside(surface[2], state):
            return state, D, True
    mean, D = posterior_moments(surface)
    if kinematic:
        reach2 = 0.5 * (WALKING_SPEED_MPS * readings[1].mean()) ** 2
        D[0, 0] += reach2
        D[1, 1] += reach2
    return mean, D, False


@njit(cache=True)
def _weighed(
    heard: tuple[IntArray, FloatArray, FloatArray], table: FloatArray, k: float, correlation: float
) -> tuple[Rows, Rows]:
    """Return the readings with their precisions, and their robust means per anchor with theirs.

    M readings with correlation rho count as ``M / (1 + rho (M - 1))`` independent ones (Kish's
    design effect); each gets its share of that.
    """
    anchor, tau_s, rssi_dbm = heard
    n = len(anchor)
    precision = np.empty(n)
    which, level = np.empty(n, np.int64), np.empty(n)
    level_precision = np.empty(n)
    groups, first = 0, 0
    for j in range(n):
        if j + 1 < n and anchor[j + 1] == anchor[j]:
            continue
        count = j + 1 - first
        effect = 1.0 + correlation * (count - 1)
        precision[first : j + 1] = 1.0 / (table[anchor[j], SIGMA] * np.sqrt(effect))
        which[groups] = anchor[j]
        level[groups] = _huber_mean(rssi_dbm[first : j + 1], k * table[anchor[j], SIGMA])
        level_precision[groups] = precision[j] * np.sqrt(count)
        groups, first = groups + 1, j + 1
    tau_zero = np.zeros(groups)
    means = (which[:groups], tau_zero, level[:groups], level_precision[:groups])
    return (anchor, tau_s, rssi_dbm, precision), means


@njit(cache=True)
def _huber_mean(values: FloatArray, bound: float) -> float:
    """Return the mean of values that count less the farther, beyond a bound, they are from it."""
    mean = values.mean()
    for _ in range(HUBER_ROUNDS):
        weighted, total = 0.0, 0.0
        for value in values:
            weight = bound / max(abs(value - mean), bound)
            weighted += weight * value
            total += weight
        mean = weighted / total
    return float(mean)


@njit(cache=True)
def _refined(
    readings: Rows,
    table: FloatArray,
    static: FloatArray,
    kinematic: bool,
    priors: Priors,
) -> tuple[FloatArray, FloatArray]:
    """Return state and information from all readings one by one, started at the static solution."""
    with_offset = len(static) == 3
    start = np.zeros((4 if kinematic else 2) + (1 if with_offset else 0))
    start[:2] = static[:2]
    if with_offset:
        start[-1] = static[-1]
    state, _, A = minimise(readings, table, start, priors)
    return state, A


@njit(cache=True)
def _inside(box: FloatArray, state: FloatArray) -> bool:
    """Return whether a place lies in the search box."""
    along, across = in_box(box, state[0], state[1])
    return bool(abs(along) <= box[4] and abs(across) <= box[5])
