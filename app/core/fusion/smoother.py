"""Fixed-interval smoothing of a whole track: every second told by everything before and after it.

Forward an extended Kalman filter over (x, y, heading bias, log step scale), the states of
`app.core.fusion.particles`, back the modified Bryson-Frazier recursion (Bierman 1973), which needs
no inverse but that of the 2 x 2 innovation covariance S:

    Λ̂ = Hᵀ S⁻¹ H + Cᵀ Λ̃ C,   λ̂ = -Hᵀ S⁻¹ y + Cᵀ λ̃,   C = I - K H
    Λ̃' = Fᵀ Λ̂ F,  λ̃' = Fᵀ λ̂;   smoothed mean = m - P λ̃,  covariance = P - P Λ̃ P

A few passes: in each the candidates of a scan are weighed again by their distance to the path of
the pass before, and where that path left the walkable floor it is drawn back to the nearest
walkable place (a measurement along the normal).
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fusion.sighting import Sighting
from app.core.fusion.stride import take_stride
from app.core.geometry import Walkable
from app.core.params import SmootherParams
from app.core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One row of a session's history: strides and drift up to a time, then what was sighted.

    Attributes
    ----------
    length_m, heading_rad : (strides,)
        Strides taken since the row before; heading nan where unknown.
    drift_m2
        Variance per axis of unobserved motion.
    walkable
        Of the floor that the carrier was on.
    """

    time_s: float
    length_m: FloatArray
    heading_rad: FloatArray
    drift_m2: float
    sighting: Sighting | None
    walkable: Walkable | None


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Places (n, 2) and their covariances (n, 2, 2), one per leg."""

    place: FloatArray
    covariance: FloatArray


def smooth(legs: list[Leg], guess: Path, params: SmootherParams) -> Path:
    """Return the path of the legs, smoothed over all of them.

    Parameters
    ----------
    guess
        A first path, e.g. that of `app.core.fusion.both_ways`.
    """
    path = guess
    strides = _strides(legs)
    prior = np.diag(
        [params.start_m**2, params.start_m**2, params.bias_prior_rad**2, params.scale_prior**2]
    )
    noise = (params.along_m**2, params.cross_m**2, params.bias_walk_rad**2)
    start = np.zeros(4)
    for i in range(params.passes):
        start[:2] = path.place[0]
        # The guess may lie in the wrong corridor; only a smoothed path is worth correcting.
        measured = _measured(legs, path, params, draw=i > 0)
        mean, covariance = _smooth(strides, measured, (start, prior), noise)
        path = Path(mean[:, :2], covariance[:, :2, :2])
    return path


def _strides(legs: list[Leg]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return strides of all legs in a row, where each leg's begin (n + 1,), and the drifts (n,)."""
    counts = [len(leg.length_m) for leg in legs]
    return (
        np.concatenate([leg.length_m for leg in legs]),
        np.concatenate([leg.heading_rad for leg in legs]),
        np.concatenate([[0.0], np.cumsum(counts)]),
        np.array([leg.drift_m2 for leg in legs]),
    )


def _measured(
    legs: list[Leg], path: Path, params: SmootherParams, *, draw: bool
) -> tuple[FloatArray, FloatArray]:
    """Return per leg a sighting (x, y, Rxx, Rxy, Ryy) and a pull (nx, ny, along n, variance).

    A variance of infinity says that there is none.
    """
    seen = np.zeros((len(legs), 5))
    pull = np.zeros((len(legs), 4))
    seen[:, 2], pull[:, 3] = math.inf, math.inf
    for i, leg in enumerate(legs):
        if leg.sighting is not None:
            gate = path.covariance[i] + params.gate_m2 * np.eye(2)
            seen[i, :2] = _seen_from(leg.sighting, path.place[i], gate)
            seen[i, 2:] = params.noise_ratio * np.asarray(leg.sighting.noise_m2)
        if draw and leg.walkable is not None:
            pull[i] = _pull(leg.walkable, path.place[i], params)
    return seen, pull


def _seen_from(sighting: Sighting, place: FloatArray, gate: FloatArray) -> FloatArray:
    """Return the mean of the candidates, weighed by their distance to a place."""
    apart = sighting.places - place
    far = 0.5 * np.einsum("ni,ij,nj->n", apart, np.linalg.inv(gate), apart)
    weight = sighting.weight * np.exp(far.min() - far)
    return np.asarray(weight @ sighting.places / weight.sum())


def _pull(
    walkable: Walkable, place: FloatArray, params: SmootherParams
) -> tuple[float, float, float, float]:
    """Return the line through the nearest walkable place, across the way to it."""
    x, y = float(place[0]), float(place[1])
    off_m = walkable.distance_at(x, y)
    step = params.slope_step_m
    dx = walkable.distance_at(x + step, y) - walkable.distance_at(x - step, y)
    dy = walkable.distance_at(x, y + step) - walkable.distance_at(x, y - step)
    slope = math.hypot(dx, dy)
    if off_m <= params.off_floor_m or slope < step * params.least_slope_ratio:
        return 0.0, 0.0, 0.0, math.inf
    nx, ny = dx / slope, dy / slope
    return nx, ny, nx * x + ny * y - off_m, params.pull_m**2


@njit(cache=True)
def _smooth(
    strides: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray],
    start: tuple[FloatArray, FloatArray],
    noise: tuple[float, float, float],
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    length, heading, first, drift = strides
    seen, pull = measured
    n = len(drift)
    mean, covariance = np.zeros((n, 4)), np.zeros((n, 4, 4))
    transition = np.zeros((n, 4, 4))
    # Two measurements a leg: the sighting, then the pull; each as gain, information and residual.
    back = np.zeros((n, 2, 4, 4))
    gained = np.zeros((n, 2, 4, 4))
    told = np.zeros((n, 2, 4))
    m, p = start[0].copy(), start[1].copy()
    for k in range(n):
        for j in range(4):
            transition[k, j, j] = 1.0
        for i in range(int(first[k]), int(first[k + 1])):
            take_stride(m, p, transition[k], (length[i], heading[i]), noise)
        p[0, 0] += drift[k]
        p[1, 1] += drift[k]
        _sight(m, p, seen[k], (back[k, 0], gained[k, 0], told[k, 0]))
        _draw(m, p, pull[k], (back[k, 1], gained[k, 1], told[k, 1]))
        _keep(m, p, mean[k], covariance[k])
    information, gradient = np.zeros((4, 4)), np.zeros(4)
    for k in range(n - 1, -1, -1):
        _revise(mean[k], covariance[k], information, gradient)
        for which in (1, 0):
            _before(information, gradient, back[k, which])
            for i in range(4):
                gradient[i] -= told[k, which, i]
                for j in range(4):
                    information[i, j] += gained[k, which, i, j]
        _before(information, gradient, transition[k])
    return mean, covariance


@njit(cache=True)
def _keep(
    m: FloatArray, p: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:  # pragma: no cover - compiled
    """Copy the state; by loops, since assigning whole arrays takes a second to compile."""
    for i in range(4):
        mean[i] = m[i]
        for j in range(4):
            covariance[i, j] = p[i, j]


@njit(cache=True)
def _sight(
    m: FloatArray,
    p: FloatArray,
    seen: FloatArray,
    kept: tuple[FloatArray, FloatArray, FloatArray],
) -> None:  # pragma: no cover - compiled
    back, gained, told = kept
    for j in range(4):
        back[j, j] = 1.0
    if math.isinf(seen[2]):
        return
    dx, dy = seen[0] - m[0], seen[1] - m[1]
    sxx, sxy, syy = p[0, 0] + seen[2], p[0, 1] + seen[3], p[1, 1] + seen[4]
    det = sxx * syy - sxy * sxy
    ixx, ixy, iyy = syy / det, -sxy / det, sxx / det
    rows = p[:2].copy()
    for j in range(4):
        gain_x = rows[0, j] * ixx + rows[1, j] * ixy
        gain_y = rows[0, j] * ixy + rows[1, j] * iyy
        m[j] += gain_x * dx + gain_y * dy
        back[j, 0] -= gain_x
        back[j, 1] -= gain_y
        for c in range(4):
            p[j, c] -= gain_x * rows[0, c] + gain_y * rows[1, c]
    gained[0, 0], gained[0, 1], gained[1, 0], gained[1, 1] = ixx, ixy, ixy, iyy
    told[0], told[1] = ixx * dx + ixy * dy, ixy * dx + iyy * dy


@njit(cache=True)
def _draw(
    m: FloatArray,
    p: FloatArray,
    pull: FloatArray,
    kept: tuple[FloatArray, FloatArray, FloatArray],
) -> None:  # pragma: no cover - compiled
    back, gained, told = kept
    for j in range(4):
        back[j, j] = 1.0
    if math.isinf(pull[3]):
        return
    nx, ny = pull[0], pull[1]
    residual = pull[2] - nx * m[0] - ny * m[1]
    row = np.empty(4)
    for j in range(4):
        row[j] = nx * p[0, j] + ny * p[1, j]
    s = nx * row[0] + ny * row[1] + pull[3]
    for j in range(4):
        m[j] += row[j] / s * residual
        back[j, 0] -= row[j] / s * nx
        back[j, 1] -= row[j] / s * ny
        for c in range(4):
            p[j, c] -= row[j] * row[c] / s
    gained[0, 0], gained[0, 1] = nx * nx / s, nx * ny / s
    gained[1, 0], gained[1, 1] = nx * ny / s, ny * ny / s
    told[0], told[1] = nx * residual / s, ny * residual / s


@njit(cache=True)
def _before(
    information: FloatArray, gradient: FloatArray, matrix: FloatArray
) -> None:  # pragma: no cover - compiled
    """Carry ``Λ <- Mᵀ Λ M`` and ``λ <- Mᵀ λ`` through one linear map."""
    carried = np.zeros(4)
    for i in range(4):
        for j in range(4):
            carried[i] += matrix[j, i] * gradient[j]
    whole = _product(matrix.T, _product(information, matrix))
    for i in range(4):
        gradient[i] = carried[i]
        for j in range(4):
            information[i, j] = whole[i, j]


@njit(cache=True)
def _product(a: FloatArray, b: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    """Return A B; by loops, since BLAS would take seconds to compile in and gain nothing here."""
    out = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            for k in range(4):
                out[i, j] += a[i, k] * b[k, j]
    return out


@njit(cache=True)
def _revise(
    m: FloatArray, p: FloatArray, information: FloatArray, gradient: FloatArray
) -> None:  # pragma: no cover - compiled
    """Turn the filtered mean and covariance into the smoothed ones: m - P λ, P - P Λ P."""
    for i in range(4):
        for j in range(4):
            m[i] -= p[i, j] * gradient[j]
    change = _product(p, _product(information, p))
    for i in range(4):
        for j in range(4):
            p[i, j] -= change[i, j]
