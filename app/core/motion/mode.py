"""Motion mode: whether the phone's carrier is still or walking.

The lateration models need it (a velocity estimated for a phone at rest doubles the error, motion
ignored spoils the fix; Grinyak et al. 2018), and so does every filter. Three kinds of evidence, the
first that is there decides:

1. **steps**, by the phone or found in its accelerometer: walking while the last one is recent;
2. **acceleration**: the running variance of its norm, in exponential forgetting
   (``m' = m + a (f - m)``, ``v' = (1 - a)(v + a (f - m)^2)``, ``a = 1 - exp(-dt / T)``; West 1979).
   A variance as low as of a phone at rest ends walking even before the last step has aged;
3. **levels alone**: the significance ``v' D_vv^-1 v`` of the velocity that the kinematic model
   estimates, against chi-square with two degrees of freedom.

Every bound is a pair (`MotionModeParams`): between the two the mode stays what it was.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numba import njit

from app.core.changed import changed
from app.core.params import MotionModeParams
from app.core.types import FloatArray, ImuBlock, MotionMode


class MotionEvidence(StrEnum):
    """What a motion mode rests on."""

    STEPS = "steps"
    ACCELERATION = "acceleration"
    LEVELS = "levels"
    NONE = "none"


@dataclass(frozen=True)
class MotionState:
    """What has been seen of a phone's motion; without slots, for `changed`.

    Attributes
    ----------
    mode
        The mode decided last.
    last_step_s
        Time of the latest step; None as long as no step was ever seen.
    acc_mean_mps2, acc_variance_m2ps4, acc_s
        Running mean and variance of the acceleration's norm, and the time they stand at.
    velocity_chi2, velocity_s
        Significance of the velocity estimated last, and when.
    """

    mode: MotionMode = MotionMode.STILL
    last_step_s: float | None = None
    acc_mean_mps2: float = 0.0
    acc_variance_m2ps4: float = 0.0
    acc_s: float | None = None
    velocity_chi2: float = 0.0
    velocity_s: float | None = None


def with_step(state: MotionState, time_s: float) -> MotionState:
    """Return the state after a step."""
    return changed(state, last_step_s=max(time_s, state.last_step_s or -math.inf))


def with_velocity(state: MotionState, time_s: float, velocity_chi2: float) -> MotionState:
    """Return the state after a velocity estimated from levels, with ``v' D_vv^-1 v``."""
    return changed(state, velocity_chi2=velocity_chi2, velocity_s=time_s)


def with_acceleration(state: MotionState, block: ImuBlock, params: MotionModeParams) -> MotionState:
    """Return the state after a block of acceleration.

    After a gap longer than the evidence lasts, the variance starts anew.
    """
    samples = len(block.acc_mps2)
    if samples == 0:
        return state
    before = state.acc_mean_mps2, state.acc_variance_m2ps4
    fresh = not _recent(state.acc_s, block.time_s, params.evidence_s)
    gain = 1.0 - math.exp(-1.0 / (block.rate_hz * params.variance_time_s))
    mean, variance = _forgetting(block.acc_mps2.astype(np.float64), gain, before, fresh)
    end_s = block.time_s + (samples - 1) / block.rate_hz
    return changed(state, acc_mean_mps2=mean, acc_variance_m2ps4=variance, acc_s=end_s)


@njit(cache=True)
def _forgetting(
    acc_mps2: FloatArray, gain: float, before: tuple[float, float], fresh: bool
) -> tuple[float, float]:  # pragma: no cover - compiled
    mean, variance = before
    for i in range(len(acc_mps2)):
        x, y, z = acc_mps2[i]
        norm = math.sqrt(x * x + y * y + z * z)
        if fresh and i == 0:
            mean, variance = norm, 0.0
        deviation = norm - mean
        mean += gain * deviation
        variance = (1.0 - gain) * (variance + gain * deviation * deviation)
    return mean, variance


def decided(state: MotionState, time_s: float, params: MotionModeParams) -> MotionState:
    """Return the state with the mode that holds at a time, by the first evidence there is."""
    mode = state.mode
    match deciding(state, time_s, params):
        case MotionEvidence.STEPS:
            stepping = _recent(state.last_step_s, time_s, params.step_hold_s)
            mode = MotionMode.WALKING if stepping else MotionMode.STILL
        case MotionEvidence.ACCELERATION:
            bounds = (params.still_variance_m2ps4, params.walk_variance_m2ps4)
            mode = _between(mode, state.acc_variance_m2ps4, bounds)
        case MotionEvidence.LEVELS:
            mode = _between(mode, state.velocity_chi2, (params.still_chi2, params.walk_chi2))
        case MotionEvidence.NONE:
            mode = MotionMode.STILL
    return state if mode is state.mode else changed(state, mode=mode)


def deciding(state: MotionState, time_s: float, params: MotionModeParams) -> MotionEvidence:
    """Return the evidence that decides the mode at a time."""
    has_acceleration = _recent(state.acc_s, time_s, params.evidence_s)
    if state.last_step_s is not None:
        stepping = _recent(state.last_step_s, time_s, params.step_hold_s)
        at_rest = has_acceleration and state.acc_variance_m2ps4 < params.still_variance_m2ps4
        return MotionEvidence.ACCELERATION if stepping and at_rest else MotionEvidence.STEPS
    if has_acceleration:
        return MotionEvidence.ACCELERATION
    if _recent(state.velocity_s, time_s, params.evidence_s):
        return MotionEvidence.LEVELS
    return MotionEvidence.NONE


def _recent(event_s: float | None, time_s: float, limit_s: float) -> bool:
    return event_s is not None and abs(time_s - event_s) <= limit_s


def _between(mode: MotionMode, value: float, bounds: tuple[float, float]) -> MotionMode:
    """Return the mode after a value against a pair of bounds (still below, walking above)."""
    still, walking = bounds
    if value > walking:
        return MotionMode.WALKING
    if value < still:
        return MotionMode.STILL
    return mode
