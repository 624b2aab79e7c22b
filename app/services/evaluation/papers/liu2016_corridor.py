"""Simulated walks for the reproduction of liu2016: where a walker was, and what told of it.

The paper walked 40 m of corridor and reports mean errors of Wi-Fi and of the accelerometer alone.
Fixes err by independent normal errors on both axes of the paper's mean; the accelerometer, along
the walker's heading, by a constant and white noise that bring its double integration to the paper's
mean; the heading by a constant and white noise of a phone's size. The walker first stands: the
first fix is the mean of the fixes heard until he leaves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from app.core.fusion.blending import SensedMotion, WifiFix
from app.core.types import FloatArray, IntArray

STRAIGHT = ((0.0, 0.0), (40.0, 0.0))
"""The paper's walk."""
ROUND = ((0.0, 0.0), (40.0, 0.0), (40.0, 20.0), (0.0, 20.0), (0.0, 0.0), (40.0, 0.0))
"""A walk that tells the weights: it has corners, and the walker stops at each."""

STEP_S = 0.1
PACE_MPS, START_S, STOP_S = 1.2, 1.0, 4.0
# People's pace wanders by a tenth over some seconds.
PACE_DEVIATION_MPS, PACE_TIME_S = 0.1, 3.0
WIFI_MEAN_ERROR_M = 2.6
WIFI_SIGMA_M = WIFI_MEAN_ERROR_M / math.sqrt(math.pi / 2.0)
"""Of each axis: the mean length of a plane normal error is sqrt(pi / 2) of it."""
ALONG_ONLY_M = (WIFI_MEAN_ERROR_M * math.sqrt(math.pi / 2.0), 0.0)
"""Of errors with the same mean length that all lie along the corridor."""
ACCELERATION_BIAS_MPS2, ACCELERATION_NOISE_MPS2 = 0.003, 0.05
HEADING_BIAS_RAD, HEADING_NOISE_RAD = math.radians(3.0), math.radians(3.0)


@dataclass(frozen=True, slots=True)
class SetUp:
    """What may be otherwise than the paper leaves to be guessed.

    Attributes
    ----------
    fix_period_s
        Time between fixes.
    stood_fixes
        Fixes heard before the walker leaves.
    alike_m
        Length of walk over which the errors of fixes stay alike; 0: they are independent.
    sigmas_m
        Of the errors of fixes, in x and y.
    """

    corners_m: Sequence[tuple[float, float]] = STRAIGHT
    fix_period_s: float = 1.0
    stood_fixes: int = 3
    alike_m: float = 0.0
    sigmas_m: tuple[float, float] = (WIFI_SIGMA_M, WIFI_SIGMA_M)


@dataclass(frozen=True, slots=True, eq=False)
class CorridorWalk:
    """One walk; everything is told at the times of its fixes.

    Attributes
    ----------
    places : (n, 2)
        Where the walker truly was.
    fixes : n
        The first one is the mean of those heard while he stood.
    sensed : n - 1
        What the sensors tell of the time before each fix but the first.
    """

    places: FloatArray
    fixes: tuple[WifiFix, ...]
    sensed: tuple[SensedMotion, ...]


def corridor_walk(rng: np.random.Generator, set_up: SetUp) -> CorridorWalk:
    """Return a walk along the corners."""
    walked_m, speed_mps = _paced(rng, set_up)
    at = np.arange(0, len(walked_m), round(set_up.fix_period_s / STEP_S))
    places, heading_rad = _along(np.array(set_up.corners_m), walked_m)
    time_s = np.asarray(at * STEP_S, dtype=np.float64)
    return CorridorWalk(
        places=places[at],
        fixes=_fixes(rng, set_up, time_s, (places[at], walked_m[at])),
        sensed=_sensed(rng, at, heading_rad, np.diff(speed_mps) / STEP_S),
    )


def _paced(rng: np.random.Generator, set_up: SetUp) -> tuple[FloatArray, FloatArray]:
    """Return distance walked and speed on the simulation's steps; he stops at every corner."""
    legs_m = np.linalg.norm(np.diff(np.array(set_up.corners_m), axis=0), axis=1)
    stop = [0.0] * round(STOP_S / STEP_S)
    speeds: list[float] = []
    for i, leg_m in enumerate(legs_m.tolist()):
        speeds += (stop if i else []) + _leg_speeds_mps(rng, leg_m)
    speed_mps = np.array([*speeds, speeds[-1]])
    return np.concatenate(([0.0], np.cumsum(speed_mps[:-1]) * STEP_S)), speed_mps


def _leg_speeds_mps(rng: np.random.Generator, leg_m: float) -> list[float]:
    """Return the speeds from a stand to the end of a leg."""
    speeds: list[float] = []
    left_m, wander_mps = leg_m, 0.0
    while left_m > 1e-9:
        wander_mps *= 1.0 - STEP_S / PACE_TIME_S
        wander_mps += PACE_DEVIATION_MPS * math.sqrt(2.0 * STEP_S / PACE_TIME_S) * rng.normal()
        started = min(1.0, len(speeds) * STEP_S / START_S)
        speeds.append(min(started * (PACE_MPS + wander_mps), left_m / STEP_S))
        left_m -= speeds[-1] * STEP_S
    return speeds


def _along(corners: FloatArray, walked_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the places (n, 2) at distances along the corners, and the direction walked there."""
    steps = np.diff(corners, axis=0)
    corner_m = np.concatenate(([0.0], np.cumsum(np.linalg.norm(steps, axis=1))))
    places = np.column_stack([np.interp(walked_m, corner_m, axis) for axis in corners.T])
    leg = np.clip(np.searchsorted(corner_m, walked_m - 1e-6, side="right") - 1, 0, len(steps) - 1)
    return places, np.arctan2(steps[leg, 1], steps[leg, 0])


def _fixes(
    rng: np.random.Generator,
    set_up: SetUp,
    time_s: FloatArray,
    truth: tuple[FloatArray, FloatArray],
) -> tuple[WifiFix, ...]:
    places, walked_m = truth
    errors_m = rng.normal(0.0, set_up.sigmas_m, places.shape)
    stood_m = rng.normal(0.0, set_up.sigmas_m, (set_up.stood_fixes, 2)).mean(axis=0)
    if set_up.alike_m > 0.0:
        # Who stands hears the same wrong fix again: its mean is no better.
        for i in range(1, len(errors_m)):
            alike = math.exp(-(walked_m[i] - walked_m[i - 1]) / set_up.alike_m)
            errors_m[i] = alike * errors_m[i - 1] + math.sqrt(1.0 - alike**2) * errors_m[i]
    else:
        errors_m[0] = stood_m
    told = places + errors_m
    return tuple(WifiFix(t, x, y) for t, (x, y) in zip(time_s.tolist(), told.tolist(), strict=True))


def _sensed(
    rng: np.random.Generator, at: IntArray, heading_rad: FloatArray, acceleration: FloatArray
) -> tuple[SensedMotion, ...]:
    bias_mps2, bias_rad = rng.normal(0.0, (ACCELERATION_BIAS_MPS2, HEADING_BIAS_RAD))
    told_mps2 = acceleration + bias_mps2
    told_mps2 = told_mps2 + rng.normal(0.0, ACCELERATION_NOISE_MPS2, len(acceleration))
    told_rad = heading_rad + bias_rad + rng.normal(0.0, HEADING_NOISE_RAD, len(heading_rad))
    return tuple(
        SensedMotion(float(told_rad[last]), float(told_mps2[first:last].mean()))
        for first, last in pairwise(at.tolist())
    )
