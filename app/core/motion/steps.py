"""Steps from the accelerometer, with the heading walked during each.

The norm of the specific force is low-passed, its slow mean taken off; a step is a rise, its peak
and the valley after it. Everything is causal: a step is told when its valley has turned.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from numba import njit

from app.core.params import StepParams
from app.core.types import FloatArray, ImuBlock

# Layout of the detector's memory; one array, so that the kernel takes and returns it whole.
_X1, _X2, _Y1, _Y2, _MEAN, _PHASE, _PEAK, _VALLEY = range(8)
_STEP_S, _INTERVAL_S, _SIN, _COS, _YAW, _UP = range(8, 14)
_SIZE = 16
_WAITING, _RISEN, _FALLING = 0.0, 1.0, 2.0

# A valley has turned when the signal came back this share of the swing (noise turns it earlier).
_TURN_SHARE = 0.1
# Longer silence than this and the filters start anew.
_GAP_S = 1.0
# Time constant of the "up" direction when the heading comes from the gyroscope alone.
_UP_TIME_S = 0.5


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a walker.

    ``swing_mps2`` is peak minus valley, ``interval_s`` the mean of the last two step intervals
    (nan after a pause), ``heading_rad`` where the phone's y axis pointed (nan if unknown).
    """

    time_s: float
    swing_mps2: float
    interval_s: float
    heading_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class StepDetector:
    """Memory of the step detector between blocks.

    Attributes
    ----------
    memory : (16,)
        Filter and phase, see the layout in this module.
    end_s
        Time just after the last sample seen; -inf at the start.
    """

    memory: FloatArray = field(default_factory=lambda: np.zeros(_SIZE))
    end_s: float = -math.inf

    @property
    def heading_rad(self) -> float:
        """Mean direction of the phone's y axis since the last step found; nan before any sample."""
        if self.end_s == -math.inf:
            return math.nan
        return math.atan2(self.memory[_SIN], self.memory[_COS])


def detect_steps(
    detector: StepDetector, block: ImuBlock, params: StepParams
) -> tuple[StepDetector, tuple[Step, ...]]:
    """Run one block through the detector; return its new memory and the steps found, in time order.

    Headings are from east with a rotation vector; with a gyroscope alone their origin is unknown.
    """
    acc = block.acc_mps2.astype(np.float64)
    fresh = block.time_s - detector.end_s > _GAP_S
    memory = _at_rest(acc[0]) if fresh else detector.memory.copy()
    yaw = azimuth_rad(block.quat_wxyz)
    gyro = block.gyro_radps.astype(np.float64) if len(block.gyro_radps) else np.zeros_like(acc)
    found = _detect(
        memory,
        (acc, gyro, yaw),
        (block.time_s, 1.0 / block.rate_hz),
        _biquad(params.lowpass_hz, block.rate_hz),
        (params.mean_time_s, params.rise_mps2, params.min_interval_s, params.pause_s),
    )
    if not len(block.quat_wxyz) and not len(block.gyro_radps):
        found[:, 3] = memory[_SIN] = memory[_COS] = math.nan
    end_s = block.time_s + len(acc) / block.rate_hz
    return (
        StepDetector(memory, end_s),
        tuple(Step(*row) for row in found.tolist()),
    )


def step_length_m(step: Step, params: StepParams) -> float:
    """Return the step's length: ``c0 + c1 A + c2 f + c3 A f``, clipped (see `StepParams`)."""
    amplitude = math.pow(step.swing_mps2, 0.25)
    cadence_hz = params.cadence_hz if math.isnan(step.interval_s) else 1.0 / step.interval_s
    c0, c1, c2, c3 = params.length_coefficients
    length_m = c0 + c1 * amplitude + c2 * cadence_hz + c3 * amplitude * cadence_hz
    return min(max(length_m, params.min_length_m), params.max_length_m)


def azimuth_rad(quat_wxyz: npt.NDArray[np.float32]) -> FloatArray:
    """Return where the phone's y axis points, radians counter-clockwise from east.

    Second column of the rotation matrix: (2(xy - wz), 1 - 2(x² + z²)) in east and north.
    """
    return _azimuth(quat_wxyz.astype(np.float64))


@njit(cache=True)
def _azimuth(quat_wxyz: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    azimuth_rad = np.empty(len(quat_wxyz))
    for i in range(len(quat_wxyz)):
        w, x, y, z = quat_wxyz[i]
        azimuth_rad[i] = math.atan2(1.0 - 2.0 * (x * x + z * z), 2.0 * (x * y - w * z))
    return azimuth_rad


def _at_rest(acc_mps2: FloatArray) -> FloatArray:
    memory = np.zeros(_SIZE)
    memory[_X1 : _MEAN + 1] = math.sqrt(float(acc_mps2 @ acc_mps2))
    memory[_STEP_S] = -math.inf
    memory[_INTERVAL_S] = math.nan
    memory[_UP : _UP + 3] = acc_mps2
    return memory


def _biquad(cutoff_hz: float, rate_hz: float) -> tuple[float, float, float]:
    # Second-order Butterworth low-pass by the bilinear transform: b = g (1, 2, 1).
    c = 1.0 / math.tan(math.pi * min(cutoff_hz / rate_hz, 0.45))
    norm = 1.0 + math.sqrt(2.0) * c + c * c
    return 1.0 / norm, 2.0 * (1.0 - c * c) / norm, (1.0 - math.sqrt(2.0) * c + c * c) / norm


@njit(cache=True)
def _detect(
    memory: FloatArray,
    samples: tuple[FloatArray, FloatArray, FloatArray],
    timing: tuple[float, float],
    lowpass: tuple[float, float, float],
    limits: tuple[float, float, float, float],
) -> FloatArray:  # pragma: no cover - compiled
    start_s, dt_s = timing
    mean_time_s, rise, min_interval_s, pause_s = limits
    m = memory
    acc, gyro, yaw = samples
    steps = np.empty((len(acc), 4))
    count = 0
    for i in range(len(acc)):
        time_s = start_s + i * dt_s
        norm = math.sqrt(acc[i, 0] ** 2 + acc[i, 1] ** 2 + acc[i, 2] ** 2)
        m[_MEAN] += min(1.0, dt_s / mean_time_s) * (norm - m[_MEAN])
        signal = _smoothed(m, norm, lowpass) - m[_MEAN]
        heading = yaw[i] if len(yaw) else _turn(m, acc[i], gyro[i], dt_s)
        m[_SIN] += math.sin(heading)
        m[_COS] += math.cos(heading)
        if m[_PHASE] == _WAITING:
            if signal > rise:
                m[_PHASE], m[_PEAK] = _RISEN, signal
        elif m[_PHASE] == _RISEN:
            m[_PEAK] = max(m[_PEAK], signal)
            if signal < 0.0:
                m[_PHASE], m[_VALLEY] = _FALLING, signal
        else:
            m[_VALLEY] = min(m[_VALLEY], signal)
            swing = m[_PEAK] - m[_VALLEY]
            if signal > m[_VALLEY] + _TURN_SHARE * swing:
                m[_PHASE] = _WAITING
                interval_s = time_s - m[_STEP_S]
                if interval_s >= min_interval_s:
                    steps[count, 0] = time_s
                    steps[count, 1] = swing
                    steps[count, 2] = _mean_interval_s(interval_s, m[_INTERVAL_S], pause_s)
                    steps[count, 3] = math.atan2(m[_SIN], m[_COS])
                    count += 1
                    m[_STEP_S], m[_INTERVAL_S] = time_s, interval_s
                    m[_SIN] = m[_COS] = 0.0
    return steps[:count]


@njit(cache=True)
def _smoothed(
    m: FloatArray, norm: float, lowpass: tuple[float, float, float]
) -> float:  # pragma: no cover - compiled
    gain, a1, a2 = lowpass
    smooth = gain * (norm + 2.0 * m[_X1] + m[_X2]) - a1 * m[_Y1] - a2 * m[_Y2]
    m[_X2], m[_X1], m[_Y2], m[_Y1] = m[_X1], norm, m[_Y1], smooth
    return float(smooth)


@njit(cache=True)
def _mean_interval_s(
    interval_s: float, previous_s: float, pause_s: float
) -> float:  # pragma: no cover - compiled
    if interval_s > pause_s:
        return math.nan
    if math.isnan(previous_s) or previous_s > pause_s:
        return interval_s
    return 0.5 * (interval_s + previous_s)


@njit(cache=True)
def _turn(
    m: FloatArray, acc: FloatArray, gyro: FloatArray, dt_s: float
) -> float:  # pragma: no cover - compiled
    # Angular rate about the slowly followed direction of gravity.
    share = min(1.0, dt_s / _UP_TIME_S)
    rate, length = 0.0, 0.0
    for axis in range(3):
        m[_UP + axis] += share * (acc[axis] - m[_UP + axis])
        rate += m[_UP + axis] * gyro[axis]
        length += m[_UP + axis] ** 2
    if length > 0.0:
        m[_YAW] += rate / math.sqrt(length) * dt_s
    return float(m[_YAW])
