"""Steps from a synthetic gait: counted, timed and turned rightly, however the blocks are cut."""

import numpy as np
import pytest

from app.core.motion.steps import Step, StepDetector, azimuth_rad, detect_steps, step_length_m
from app.core.params import StepParams
from app.core.types import ImuBlock

PARAMS = StepParams()
EMPTY = np.empty((0, 3), dtype=np.float32)


def gait(seconds, cadence_hz=1.8, swing=3.0, rate_hz=50.0, noise=0.2, seed=0):
    """A walk's vertical acceleration: a sine at the cadence on gravity, with sensor noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    acc = rng.normal(0.0, noise, (len(time_s), 3))
    acc[:, 2] += 9.81 + swing * np.sin(2 * np.pi * cadence_hz * time_s)
    return acc.astype(np.float32)


def blocks(acc, cut_s=1.0, rate_hz=50.0, start_s=1000.0, quat=None, gyro=None):
    size = int(cut_s * rate_hz)
    for i in range(0, len(acc), size):
        part = slice(i, i + size)
        yield ImuBlock(
            start_s + i / rate_hz,
            rate_hz,
            acc[part],
            EMPTY if gyro is None else gyro[part],
            EMPTY,
            np.empty((0, 4), dtype=np.float32) if quat is None else quat[part],
        )


def steps_of(acc, **kwargs):
    detector, steps = StepDetector(), []
    for block in blocks(acc, **kwargs):
        detector, found = detect_steps(detector, block, PARAMS)
        steps.extend(found)
    return steps


@pytest.mark.parametrize("cadence_hz", [1.4, 1.8, 2.2])
@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 100.0])
def test_a_gait_is_counted(cadence_hz, rate_hz):
    steps = steps_of(gait(30.0, cadence_hz, rate_hz=rate_hz), rate_hz=rate_hz)
    assert len(steps) == pytest.approx(30.0 * cadence_hz, abs=2)
    intervals = np.diff([s.time_s for s in steps])
    assert np.median(intervals) == pytest.approx(1.0 / cadence_hz, rel=0.05)


def test_a_phone_at_rest_makes_no_steps():
    assert steps_of(gait(60.0, swing=0.0, noise=0.15)) == []


def test_cutting_blocks_elsewhere_changes_nothing():
    acc = gait(12.0)
    one, other = steps_of(acc, cut_s=1.0), steps_of(acc, cut_s=3.0)
    assert [s.swing_mps2 for s in one] == [s.swing_mps2 for s in other]
    assert np.allclose([s.time_s for s in one], [s.time_s for s in other], atol=1e-6)


def test_after_a_gap_the_filters_start_anew():
    acc = gait(4.0)
    detector, _ = detect_steps(StepDetector(), next(blocks(acc, cut_s=4.0)), PARAMS)
    later = next(blocks(acc, cut_s=4.0, start_s=2000.0))
    fresh, found = (detect_steps(d, later, PARAMS)[1] for d in (StepDetector(), detector))
    assert [(s.time_s, s.swing_mps2) for s in found] == [(s.time_s, s.swing_mps2) for s in fresh]


@pytest.mark.parametrize("yaw_deg", [-170.0, -45.0, 0.0, 90.0, 135.0])
def test_heading_is_where_the_phone_points(yaw_deg):
    half = np.radians(yaw_deg) / 2  # a turn about "up" of a phone whose y axis pointed north
    acc = gait(5.0)
    quat = np.tile([np.cos(half), 0, 0, np.sin(half)], (len(acc), 1)).astype(np.float32)
    assert np.cos(azimuth_rad(quat)[0] - np.radians(yaw_deg + 90)) == pytest.approx(1.0, abs=1e-6)
    heading = steps_of(acc, quat=quat)[-1].heading_rad
    assert np.cos(heading - np.radians(yaw_deg + 90)) == pytest.approx(1.0, abs=1e-6)


def test_without_rotation_vector_turns_come_from_the_gyroscope():
    acc = gait(8.0)
    gyro = np.zeros_like(acc)
    gyro[150:250, 2] = np.pi / 4  # a quarter turn to the left in two seconds
    steps = steps_of(acc, gyro=gyro)
    assert steps[-1].heading_rad - steps[2].heading_rad == pytest.approx(np.pi / 2, abs=0.05)


def test_without_any_turning_sensor_the_heading_is_unknown():
    assert all(np.isnan(s.heading_rad) for s in steps_of(gait(5.0)))
    detector, _ = detect_steps(StepDetector(), next(blocks(gait(2.0), cut_s=2.0)), PARAMS)
    assert np.isnan(detector.heading_rad)


def test_longer_steps_swing_more_and_stay_human():
    lengths = [step_length_m(Step(0.0, swing, 0.55, 0.0), PARAMS) for swing in (0.5, 2, 4, 8, 200)]
    assert lengths == sorted(lengths)
    assert lengths[0] >= PARAMS.min_length_m
    assert lengths[-1] == PARAMS.max_length_m
    assert 0.45 < step_length_m(Step(0.0, 5.0, float("nan"), 0.0), PARAMS) < 0.8


def test_the_detector_leaves_its_input_alone():
    block = next(blocks(gait(2.0), cut_s=2.0))
    detector, _ = detect_steps(StepDetector(), block, PARAMS)
    before = detector.memory.copy()
    detect_steps(detector, block, PARAMS)
    assert np.array_equal(before, detector.memory, equal_nan=True)
