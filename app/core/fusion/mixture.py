"""Gaussian-sum filter over (x, y, heading bias, log step scale), fed with weighted candidates.

Each component is an extended Kalman filter; several of them keep several places alive until dead
reckoning and scans agree on one (Sorenson and Alspach 1971). One component alone is the plain EKF.

Model, per step of length l walked in the phone's direction h:
    x += l e^s cos(h + b),  y += l e^s sin(h + b),  b += N(0, bias_walk²)
and per scan with candidates c_i of weight w_i: p(scan | x, y) = Σ w_i N(c_i; (x, y), R) + clutter.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fusion.sighting import Noise
from app.core.fusion.stride import take_stride
from app.core.params import FusionParams
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """State of the filter.

    Attributes
    ----------
    mean : (k, 4)
        x (m), y (m), heading bias (rad), log step scale of each component.
    covariance : (k, 4, 4)
        Of the same.
    weight : (k,)
        Sums to 1, largest first.
    """

    mean: FloatArray
    covariance: FloatArray
    weight: FloatArray


def moments(mixture: Mixture) -> tuple[FloatArray, FloatArray]:
    """Return mean (4,) and covariance (4, 4) of the whole mixture.

    m = Σ w_k m_k,  P = Σ w_k (P_k + (m_k - m)(m_k - m)ᵀ).
    """
    mean = mixture.weight @ mixture.mean
    apart = mixture.mean - mean
    within = (mixture.weight @ mixture.covariance.reshape(-1, 16)).reshape(4, 4)
    return mean, within + (apart.T * mixture.weight) @ apart


def begin(places: FloatArray, weight: FloatArray, noise_m2: Noise, params: FusionParams) -> Mixture:
    """Return the filter's first state from the candidates of one scan.

    Parameters
    ----------
    places : (n, 2)
        Candidates, m.
    weight : (n,)
        Their weights, summing to 1.
    noise_m2
        Covariance ``(xx, xy, yy)`` of a candidate about the truth.
    """
    mean, covariance, weights = _births(
        places, weight, noise_m2, _priors(params), params.components
    )
    return Mixture(mean, covariance, weights)


def walk(mixture: Mixture, length_m: float, heading_rad: float, params: FusionParams) -> Mixture:
    """Return the mixture after one step; a heading of nan spreads it in all directions."""
    mean, covariance = mixture.mean.copy(), mixture.covariance.copy()
    _walk(mean, covariance, (length_m, heading_rad), _step_noise(params))
    return Mixture(mean, covariance, mixture.weight)


def diffuse(mixture: Mixture, variance_m2: float) -> Mixture:
    """Return the mixture after unobserved motion of this variance per axis."""
    covariance = mixture.covariance.copy()
    covariance[:, 0, 0] += variance_m2
    covariance[:, 1, 1] += variance_m2
    return Mixture(mixture.mean, covariance, mixture.weight)


def update(
    mixture: Mixture, places: FloatArray, weight: FloatArray, noise_m2: Noise, params: FusionParams
) -> Mixture:
    """Return the mixture after a scan's candidates; parameters as in `begin`.

    Each component takes the mean of the candidates as seen from it (re-weighted by their distance
    to its prediction, gate ``candidate_gate_m2``), with R divided by a Student weight so that a far
    fix pulls little; its own weight grows with the likelihood to the power ``tempering`` (scans
    are not independent). A share ``birth_share`` of weight starts anew from the candidates.
    """
    mean, covariance = mixture.mean.copy(), mixture.covariance.copy()
    log_weight = np.log(mixture.weight)
    _update(
        (mean, covariance, log_weight),
        (places, weight),
        noise_m2,
        (params.candidate_gate_m2, params.student_dof, params.clutter, params.tempering),
    )
    weights = np.exp(log_weight - log_weight.max())
    weights /= weights.sum()
    if params.birth_share > 0.0:
        born = _births(places, weight, noise_m2, _priors(params), params.births)
        mean = np.concatenate([mean, born[0]])
        covariance = np.concatenate([covariance, born[1]])
        weights = np.concatenate(
            [weights * (1.0 - params.birth_share), born[2] * params.birth_share]
        )
    return Mixture(*_reduce(mean, covariance, weights, params.components, params.merge_distance))


def _priors(params: FusionParams) -> tuple[float, float]:
    return params.bias_prior_rad**2, params.scale_prior**2


def _step_noise(params: FusionParams) -> tuple[float, float, float]:
    return params.along_m**2, params.cross_m**2, params.bias_walk_rad**2


@njit(cache=True)
def _walk(
    mean: FloatArray,
    covariance: FloatArray,
    stride: tuple[float, float],
    noise: tuple[float, float, float],
) -> None:  # pragma: no cover - compiled
    unused = np.zeros((4, 4))
    for k in range(len(mean)):
        take_stride(mean[k], covariance[k], unused, stride, noise)


@njit(cache=True)
def _update(
    components: tuple[FloatArray, FloatArray, FloatArray],
    candidates: tuple[FloatArray, FloatArray],
    noise_m2: Noise,
    rule: tuple[float, float, float, float],
) -> None:  # pragma: no cover - compiled
    gate_m2, student_dof, clutter, tempering = rule
    mean, covariance, log_weight = components
    places, weight = candidates
    seen = np.empty(len(places))
    for k in range(len(mean)):
        m, p = mean[k], covariance[k]
        sxx, sxy, syy = p[0, 0] + gate_m2, p[0, 1], p[1, 1] + gate_m2
        det = sxx * syy - sxy * sxy
        nearest = math.inf
        for i in range(len(places)):
            dx, dy = places[i, 0] - m[0], places[i, 1] - m[1]
            seen[i] = 0.5 * (syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy) / det
            nearest = min(nearest, seen[i])
        total, zx, zy = 0.0, 0.0, 0.0
        for i in range(len(places)):
            seen[i] = weight[i] * math.exp(nearest - seen[i])
            total += seen[i]
            zx += seen[i] * places[i, 0]
            zy += seen[i] * places[i, 1]
        likelihood = total * math.exp(-nearest) / (2.0 * math.pi * math.sqrt(det))
        log_weight[k] += tempering * math.log(likelihood + clutter)
        zx, zy = zx / total, zy / total
        _correct(m, p, zx, zy, noise_m2, student_dof)


@njit(cache=True)
def _correct(
    m: FloatArray, p: FloatArray, zx: float, zy: float, noise_m2: Noise, student_dof: float
) -> None:  # pragma: no cover - compiled
    dx, dy = zx - m[0], zy - m[1]
    rxx, rxy, ryy = noise_m2
    sxx, sxy, syy = p[0, 0] + rxx, p[0, 1] + rxy, p[1, 1] + ryy
    nis = (syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy) / (sxx * syy - sxy * sxy)
    wider = max(1.0, (student_dof + nis) / (student_dof + 2.0))
    sxx, sxy, syy = p[0, 0] + wider * rxx, p[0, 1] + wider * rxy, p[1, 1] + wider * ryy
    det = sxx * syy - sxy * sxy
    gain = np.empty((4, 2))
    for j in range(4):
        gain[j, 0] = (p[j, 0] * syy - p[j, 1] * sxy) / det
        gain[j, 1] = (p[j, 1] * sxx - p[j, 0] * sxy) / det
    row_x, row_y = p[0].copy(), p[1].copy()
    for j in range(4):
        m[j] += gain[j, 0] * dx + gain[j, 1] * dy
        for c in range(4):
            p[j, c] -= gain[j, 0] * row_x[c] + gain[j, 1] * row_y[c]
    for j in range(4):
        for c in range(j):
            p[j, c] = p[c, j] = 0.5 * (p[j, c] + p[c, j])


def _births(
    places: FloatArray,
    weight: FloatArray,
    noise_m2: Noise,
    priors: tuple[float, float],
    most: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    xx, xy, yy = noise_m2
    mean = np.zeros((len(places), 4))
    mean[:, :2] = places
    one = np.diag([xx, yy, *priors])
    one[0, 1] = one[1, 0] = xy
    return _reduce(mean, np.tile(one, (len(places), 1, 1)), weight, most, 1.0)


def _reduce(
    mean: FloatArray, covariance: FloatArray, weight: FloatArray, most: int, merge_distance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge components closer than ``merge_distance`` sigmas, then keep the ``most`` heaviest.

    Merging keeps mean and covariance (Salmond 1990): the heaviest takes in its neighbours first.
    """
    order = np.argsort(-weight, kind="stable")
    merged = _merge((mean[order], covariance[order], weight[order]), most, merge_distance)
    heaviest = np.argsort(-merged[2], kind="stable")
    weights = merged[2][heaviest]
    return merged[0][heaviest], merged[1][heaviest], weights / weights.sum()


@njit(cache=True)
def _merge(
    components: tuple[FloatArray, FloatArray, FloatArray], most: int, merge_distance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:  # pragma: no cover - compiled
    mean, covariance, weight = components
    n = len(weight)
    left = np.ones(n, dtype=np.bool_)
    member = np.empty(n, dtype=np.int64)
    out_mean, out_cov = np.zeros((most, 4)), np.zeros((most, 4, 4))
    out_weight = np.zeros(most)
    count = 0
    for head in range(n):
        if not left[head] or count == most:
            continue
        members = 0
        for i in range(head, n):
            if left[i] and _apart2(mean[i], mean[head], covariance[head]) <= merge_distance**2:
                left[i] = False
                member[members] = i
                members += 1
        _join(components, member[:members], out_mean[count], out_cov[count])
        for i in member[:members]:
            out_weight[count] += weight[i]
        count += 1
    return out_mean[:count], out_cov[:count], out_weight[:count]


@njit(cache=True)
def _apart2(a: FloatArray, b: FloatArray, p: FloatArray) -> float:  # pragma: no cover - compiled
    """Return the squared Mahalanobis distance of two places under the covariance of the second."""
    dx, dy = a[0] - b[0], a[1] - b[1]
    det = p[0, 0] * p[1, 1] - p[0, 1] * p[0, 1]
    return float((p[1, 1] * dx * dx - 2.0 * p[0, 1] * dx * dy + p[0, 0] * dy * dy) / det)


@njit(cache=True)
def _join(
    components: tuple[FloatArray, FloatArray, FloatArray],
    member: IntArray,
    out_mean: FloatArray,
    out_cov: FloatArray,
) -> None:  # pragma: no cover - compiled
    mean, covariance, weight = components
    total = 0.0
    for i in member:
        total += weight[i]
    for i in member:
        for j in range(4):
            out_mean[j] += weight[i] / total * mean[i, j]
    for i in member:
        for j in range(4):
            for c in range(4):
                apart = (mean[i, j] - out_mean[j]) * (mean[i, c] - out_mean[c])
                out_cov[j, c] += weight[i] / total * (covariance[i, j, c] + apart)
