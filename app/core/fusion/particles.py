"""Particle filter over (x, y, heading bias, step scale), fed with weighted candidates.

Particles keep as many places alive as the scans leave open, and know where people can walk: neither
is normal (Gordon, Salmond and Smith 1993). Per step of length l walked in the phone's direction h:

    b += N(0, bias_walk²),   θ = h + b + N(0, heading_noise²)
    x += l s (1 + N(0, length_noise²)) cos θ,   y += l s (1 + N(0, length_noise²)) sin θ

with s the step scale. A particle d metres off the walkable floor loses ``off_floor_weight`` d of
its log weight, ``leave_floor_weight`` for each metre that the step took it farther off, and
``way_weight`` times what the ways say against its direction (`app.core.fusion.ways`). Per scan with
candidates c_i of weight w_i:

    log w += tempering log(Σ w_i N(c_i; (x, y), R) + clutter)

Draws are made along east and north, so a plan that is turned turns the particles with it.
"""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.fusion.draws import normal, uniform
from app.core.fusion.ground import Ground, off_floor_m, way_log_weight
from app.core.fusion.sighting import Noise, Sighting
from app.core.params import FusionParams
from app.core.types import FloatArray

X, Y, BIAS, SCALE = range(4)

DRAWS = 8
"""Draws of one particle in one call, at most."""

NEGLIGIBLE = 20.0
"""Candidates this far off (half the squared sigmas) add less than a billionth: passed over."""

RESAMPLE_SHARE = 0.5
"""Resampling is due when fewer than this share of the particles carry the weight (customary)."""


@dataclass(frozen=True, slots=True, eq=False)
class Particles:
    """State of the filter.

    Attributes
    ----------
    state : (n, 4)
        x (m), y (m), heading bias (rad), step scale (ratio) of each particle.
    log_weight : (n,)
        Logarithms of their weights, the largest 0.
    counter
        Draws made so far; the next ones follow from it.
    """

    state: FloatArray
    log_weight: FloatArray
    counter: int


Factor: TypeAlias = tuple[float, float, float, float]
"""What turns two normal draws into an offset about a candidate: (xx, xy, yx, yy) of a matrix."""

Cloud: TypeAlias = tuple[FloatArray, FloatArray, Factor]
"""Candidates (n, 2), their weights summed up (n,), and the factor of their covariance."""

Pair: TypeAlias = tuple[FloatArray, FloatArray]
"""State (n, 4) and log weight (n,) of `Particles`, as kernels take and return them."""

Rules: TypeAlias = tuple[float, float, float, float]
"""``off_floor_weight``, ``leave_floor_weight``, ``far_off_m`` and ``way_weight`` of
`FusionParams`."""


def weights(particles: Particles) -> FloatArray:
    """Return the particles' weights (n,), summing to 1."""
    w = np.exp(particles.log_weight)
    return np.asarray(w / w.sum())


def moments(particles: Particles) -> tuple[FloatArray, FloatArray]:
    """Return the mean (4,) of all particles and the covariance (2, 2) of their places."""
    return _moments(particles.state, particles.log_weight)


def begin(sighting: Sighting, floor: Ground, params: FusionParams, counter: int = 0) -> Particles:
    """Return the filter's first state, drawn from the candidates of one scan.

    ``counter`` is that of the particles before it, where the filter begins anew.
    """
    state = np.empty((params.particles, 4))
    log_weight = np.zeros(params.particles)
    _draw_all(state, _cloud(sighting, floor.east), _priors(params), counter)
    _stand(state, log_weight, (params.leave_floor_weight, params.far_off_m), floor)
    return Particles(state, log_weight, _after(counter, len(state)))


def walk(
    particles: Particles, stride: tuple[float, float], floor: Ground, params: FusionParams
) -> Particles:
    """Return the particles after a step of a length (m) in a direction (rad).

    A direction of nan spreads them in all directions.
    """
    noise = (
        params.bias_walk_rad,
        params.scale_walk,
        params.length_noise_ratio,
        params.heading_noise_rad,
    )
    rules = (
        params.off_floor_weight,
        params.leave_floor_weight,
        params.far_off_m,
        params.way_weight,
    )
    before = particles.state, particles.log_weight
    state, log_weight = _walked(before, stride, (noise, rules), floor, particles.counter)
    return Particles(state, log_weight, _after(particles.counter, len(state)))


def diffuse(particles: Particles, variance_m2: float, floor: Ground) -> Particles:
    """Return the particles after unobserved motion of this variance per axis."""
    state = particles.state.copy()
    _shake(state, (math.sqrt(variance_m2), 0.0), floor.east, particles.counter)
    return Particles(state, particles.log_weight, _after(particles.counter, len(state)))


def update(
    particles: Particles, sighting: Sighting, floor: Ground, params: FusionParams
) -> Particles:
    """Return the particles after a scan: weighed, resampled where few are left, some born anew.

    After systematic resampling each copy moves by a share ``jitter_share`` of the cloud's own
    spread, or copies would stay one. A share ``birth_share`` starts anew from the candidates, so
    that no place is ever ruled out.
    """
    rule = params.clutter, params.tempering
    jitter = params.jitter_share, params.jitter_max_m, params.bias_jitter_share
    born, counter = int(params.birth_share * len(particles.state)), particles.counter
    state, log_weight = _updated(
        (particles.state, particles.log_weight),
        (sighting.places, sighting.weight, sighting.noise_m2),
        (rule, jitter, floor.east),
        (born, _cloud(sighting, floor.east), _priors(params)),
        (counter, _after(counter, len(particles.state))),
    )
    return Particles(state, log_weight, _after(_after(counter, len(state)), len(state)))


def _cloud(sighting: Sighting, east: tuple[float, float]) -> Cloud:
    """Return the candidates in the form that is drawn from.

    Their factor is that of Cholesky in a frame whose first axis is east, seen from the plan's.
    """
    (xx, xy, yy), (c, s) = sighting.noise_m2, east
    a = math.sqrt(c * c * xx + 2.0 * c * s * xy + s * s * yy)
    b = (c * s * (yy - xx) + (c * c - s * s) * xy) / a
    d = math.sqrt(s * s * xx - 2.0 * c * s * xy + c * c * yy - b * b)
    factor = c * a - s * b, -s * d, s * a + c * b, c * d
    return sighting.places, sighting.weight.cumsum(), factor


def _priors(params: FusionParams) -> tuple[float, float]:
    return params.bias_prior_rad, params.scale_prior


def _after(counter: int, count: int) -> int:
    return counter + DRAWS * (count + 1)


@register_jitable
def _draw(
    one: FloatArray,
    share: float,
    drawn: tuple[Cloud, tuple[float, float]],
    at: int,
    side: float,
) -> None:
    """Draw a particle about the candidate at a share of their weight; ``side`` -1: its mirror."""
    (places, summed, factor), priors = drawn
    which = min(np.searchsorted(summed, share * summed[-1]), len(summed) - 1)
    first, second = side * normal(at), side * normal(at + 1)
    one[X] = places[which, 0] + factor[0] * first + factor[1] * second
    one[Y] = places[which, 1] + factor[2] * first + factor[3] * second
    one[BIAS] = side * priors[0] * normal(at + 2)
    one[SCALE] = 1.0 + side * priors[1] * normal(at + 3)


@njit(cache=True)
def _moments(
    state: FloatArray, log_weight: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    w = np.exp(log_weight)
    w /= w.sum()
    mean = np.zeros(4)
    for k in range(len(state)):
        for i in range(4):
            mean[i] += w[k] * state[k, i]
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(len(state)):
        dx, dy = state[k, X] - mean[X], state[k, Y] - mean[Y]
        xx += w[k] * dx * dx
        xy += w[k] * dx * dy
        yy += w[k] * dy * dy
    return mean, np.array([[xx, xy], [xy, yy]])


@njit(cache=True)
def _draw_all(
    state: FloatArray, cloud: Cloud, priors: tuple[float, float], at: int
) -> None:  # pragma: no cover - compiled
    # In mirrored pairs (antithetic draws): a first fix lies where its scan says, not beside it.
    pairs = (len(state) + 1) // 2
    for k in range(len(state)):
        here = at + DRAWS * (k // 2 + 1)
        share = (k // 2 + uniform(here)) / pairs
        _draw(state[k], share, (cloud, priors), here + 1, 1.0 - 2.0 * (k % 2))


@njit(cache=True)
def _stand(
    state: FloatArray, log_weight: FloatArray, rule: tuple[float, float], floor: Ground
) -> None:  # pragma: no cover - compiled
    for k in range(len(state)):
        log_weight[k] -= rule[0] * off_floor_m(floor, state[k, X], state[k, Y], rule[1])
    log_weight -= log_weight.max()


@njit(cache=True)
def _walked(
    before: Pair,
    stride: tuple[float, float],
    rule: tuple[tuple[float, float, float, float], Rules],
    floor: Ground,
    at: int,
) -> Pair:  # pragma: no cover - compiled
    state, log_weight = before[0].copy(), before[1].copy()
    off_floor, leave_floor, far_m, way = rule[1]
    length, direction = _steps(state, stride, rule[0], floor[3], at)
    # Apart from the draws and from what looks at the floor, sines and cosines take half the time.
    dx_m, dy_m = length * np.cos(direction), length * np.sin(direction)
    for k in range(len(state)):
        one = state[k]
        before_m = off_floor_m(floor, one[X], one[Y], far_m)
        one[X] += dx_m[k]
        one[Y] += dy_m[k]
        off_m = off_floor_m(floor, one[X], one[Y], far_m)
        log_weight[k] -= off_floor * off_m + leave_floor * max(off_m - before_m, 0.0)
        log_weight[k] += way * way_log_weight(floor, one[X], one[Y], direction[k])
    return state, log_weight - log_weight.max()


@register_jitable
def _steps(
    state: FloatArray,
    stride: tuple[float, float],
    noise: tuple[float, float, float, float],
    east_rad: float,
    at: int,
) -> Pair:
    """Let bias and scale wander; return length (m) and direction (rad) of each particle's step."""
    length_m, heading_rad = stride
    bias_walk, scale_walk, length_noise, heading_noise = noise
    lost = math.isnan(heading_rad)
    length, direction = np.empty(len(state)), np.empty(len(state))
    for k in range(len(state)):
        here, one = at + DRAWS * (k + 1), state[k]
        one[BIAS] += bias_walk * normal(here)
        one[SCALE] += scale_walk * normal(here + 1)
        length[k] = length_m * one[SCALE] * (1.0 + length_noise * normal(here + 2))
        direction[k] = heading_rad + one[BIAS] + heading_noise * normal(here + 3)
        if lost:
            direction[k] = 2.0 * math.pi * uniform(here + 3) + east_rad
    return length, direction


@njit(cache=True)
def _updated(
    before: Pair,
    seen: tuple[FloatArray, FloatArray, Noise],
    rule: tuple[tuple[float, float], tuple[float, float, float], tuple[float, float]],
    newborn: tuple[int, Cloud, tuple[float, float]],
    at: tuple[int, int],
) -> Pair:  # pragma: no cover - compiled
    likelihood, jitter, east = rule
    born, cloud, priors = newborn
    weighed = before[0].copy(), before[1].copy()
    _weigh(weighed, seen, likelihood)
    resampled = _resampled(weighed, (jitter, east), at[0])
    _bear(resampled, born, (cloud, priors), at[1])
    return resampled[0], resampled[1] - resampled[1].max()


@njit(cache=True)
def _weigh(
    particles: Pair, seen: tuple[FloatArray, FloatArray, Noise], rule: tuple[float, float]
) -> None:  # pragma: no cover - compiled
    state, log_weight = particles
    places, weight, (xx, xy, yy) = seen
    det = xx * yy - xy * xy
    peak = 1.0 / (2.0 * math.pi * math.sqrt(det))
    along, both, across = 0.5 * yy / det, xy / det, 0.5 * xx / det
    # Apart from the exponentials, distances to a candidate take several particles at a time.
    x_m, y_m = state[:, X].copy(), state[:, Y].copy()
    likelihood, far = np.zeros(len(state)), np.empty(len(state))
    for i in range(len(places)):
        for k in range(len(state)):
            dx, dy = places[i, 0] - x_m[k], places[i, 1] - y_m[k]
            far[k] = along * dx * dx - both * dx * dy + across * dy * dy
        for k in range(len(state)):
            if far[k] < NEGLIGIBLE:
                likelihood[k] += weight[i] * math.exp(-far[k])
    for k in range(len(state)):
        log_weight[k] += rule[1] * math.log(peak * likelihood[k] + rule[0])


@njit(cache=True)
def _resampled(
    particles: Pair, rule: tuple[tuple[float, float, float], tuple[float, float]], at: int
) -> Pair:  # pragma: no cover - compiled
    state, log_weight = particles
    (jitter, most_m, bias_jitter), east = rule
    count = len(state)
    w = np.exp(log_weight - log_weight.max())
    w /= w.sum()
    if RESAMPLE_SHARE * count * (w * w).sum() < 1.0:
        return particles
    spread = np.zeros(3)
    for j in range(3):
        mean = (w * state[:, j]).sum()
        spread[j] = (w * (state[:, j] - mean) ** 2).sum()
    copies = np.empty_like(state)
    summed, source = w[0], 0
    first = uniform(at)
    for k in range(count):
        while summed * count < k + first and source < count - 1:
            source += 1
            summed += w[source]
        for j in range(4):
            copies[k, j] = state[source, j]
    sigma_m = min(jitter * math.sqrt(0.5 * (spread[X] + spread[Y])), most_m)
    _shake(copies, (sigma_m, bias_jitter * math.sqrt(spread[BIAS])), east, at)
    return copies, np.zeros(count)


@njit(cache=True)
def _shake(
    state: FloatArray, sigma: tuple[float, float], east: tuple[float, float], at: int
) -> None:  # pragma: no cover - compiled
    for k in range(len(state)):
        here = at + DRAWS * (k + 1)
        along, across = sigma[0] * normal(here), sigma[0] * normal(here + 1)
        state[k, X] += east[0] * along - east[1] * across
        state[k, Y] += east[1] * along + east[0] * across
        state[k, BIAS] += sigma[1] * normal(here + 2)


@njit(cache=True)
def _bear(
    particles: Pair, born: int, drawn: tuple[Cloud, tuple[float, float]], at: int
) -> None:  # pragma: no cover - compiled
    """Replace particles here and there by new ones of mean weight."""
    state, log_weight = particles
    mean = math.log(np.exp(log_weight).mean())
    for b in range(born):
        here = at + DRAWS * (b + 1)
        k = int(uniform(here) * len(state))
        _draw(state[k], uniform(here + 1), drawn, here + 2, 1.0)
        log_weight[k] = mean
