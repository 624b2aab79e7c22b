"""Still or walking, from steps, from acceleration, from levels alone."""

from dataclasses import replace

import numpy as np
import pytest
from lateration_room import NOW_S, corners_and_middles, window_at

from app.core.lateration.windowed import Estimate, estimate
from app.core.motion.mode import (
    MotionState,
    decided,
    with_acceleration,
    with_step,
    with_velocity,
)
from app.core.params import LaterationParams, MotionModeParams
from app.core.types import ImuBlock, MotionMode

PARAMS = MotionModeParams()
RATE_HZ = 50.0


def block(time_s, *, walking, rng, seconds=1.0) -> ImuBlock:
    """A second of a phone in the hand: gravity, tremor, and with every step a swing."""
    n = int(seconds * RATE_HZ)
    t = time_s + np.arange(n) / RATE_HZ
    acc = rng.normal(0.0, 0.08, (n, 3))
    acc[:, 2] += 9.81
    if walking:
        acc[:, 2] += 2.5 * np.sin(2 * np.pi * 1.8 * t)
    none = np.empty((0, 3), dtype=np.float32)
    quaternion = np.empty((0, 4), dtype=np.float32)
    return ImuBlock(time_s, RATE_HZ, acc.astype(np.float32), none, none, quaternion)


def modes_by_second(walking_seconds, *, rng, with_steps, with_imu) -> list[MotionMode]:
    state, modes, next_step = MotionState(), [], None
    for second, walking in enumerate(walking_seconds):
        start_s = 100.0 + second
        if with_imu:
            state = with_acceleration(state, block(start_s, walking=walking, rng=rng), PARAMS)
        if with_steps and walking:
            next_step = max(next_step or start_s, start_s)
            while next_step < start_s + 1.0:
                state = with_step(state, next_step)
                next_step += rng.uniform(0.45, 0.7)
        state = decided(state, start_s + 1.0, PARAMS)
        modes.append(state.mode)
    return modes


def test_nothing_seen_is_still():
    assert decided(MotionState(), 5.0, PARAMS).mode is MotionMode.STILL


@pytest.mark.parametrize("with_imu", [False, True])
def test_steps_tell_the_mode_in_97_of_100_windows(with_imu):
    rng = np.random.default_rng(7)
    walking = np.repeat(rng.permutation(np.arange(12) % 2 == 0), 60).tolist()
    walking[:30] = [True] * 30
    modes = modes_by_second(walking, rng=rng, with_steps=True, with_imu=with_imu)
    right = [(m is MotionMode.WALKING) == w for m, w in zip(modes, walking, strict=True)]
    assert np.mean(right) >= 0.97


def test_acceleration_alone_tells_the_mode():
    rng = np.random.default_rng(8)
    walking = ([False] * 60 + [True] * 60) * 3
    modes = modes_by_second(walking, rng=rng, with_steps=False, with_imu=True)
    right = [(m is MotionMode.WALKING) == w for m, w in zip(modes, walking, strict=True)]
    assert np.mean(right) >= 0.95


def test_acceleration_alone_ends_walking_within_a_window():
    rng = np.random.default_rng(10)
    walked = block(100.0, walking=True, rng=rng, seconds=10.0)
    state = decided(with_acceleration(MotionState(), walked, PARAMS), 110.0, PARAMS)
    assert state.mode is MotionMode.WALKING
    rested = with_acceleration(state, block(110.0, walking=False, rng=rng, seconds=1.6), PARAMS)
    assert decided(rested, 111.6, PARAMS).mode is MotionMode.STILL


def test_a_phone_at_rest_ends_walking_before_the_last_step_has_aged():
    rng = np.random.default_rng(9)
    state = with_step(MotionState(), 101.0)
    walking = with_acceleration(state, block(100.0, walking=True, rng=rng, seconds=1.5), PARAMS)
    assert decided(walking, 101.5, PARAMS).mode is MotionMode.WALKING
    resting = with_acceleration(state, block(100.0, walking=False, rng=rng, seconds=1.5), PARAMS)
    assert decided(resting, 101.5, PARAMS).mode is MotionMode.STILL


def test_between_the_bounds_the_mode_stays():
    middle = 0.5 * (PARAMS.walk_chi2 + PARAMS.still_chi2)
    seen = with_velocity(MotionState(), 10.0, middle)
    assert decided(seen, 10.0, PARAMS).mode is MotionMode.STILL
    was_walking = replace(seen, mode=MotionMode.WALKING)
    assert decided(was_walking, 10.0, PARAMS).mode is MotionMode.WALKING
    calm = with_velocity(was_walking, 11.0, 0.5)
    assert decided(calm, 11.0, PARAMS).mode is MotionMode.STILL


def test_old_evidence_is_none():
    moving = with_velocity(MotionState(mode=MotionMode.WALKING), 10.0, 50.0)
    assert decided(moving, 11.0, PARAMS).mode is MotionMode.WALKING
    assert decided(moving, 10.0 + PARAMS.evidence_s + 1.0, PARAMS).mode is MotionMode.STILL


def modes_from_levels(velocity, count, seed) -> list[MotionMode]:
    model, rng, modes = corners_and_middles(), np.random.default_rng(seed), []
    state = MotionState()
    for k in range(count):
        window = window_at(model, rng.uniform(2.0, 8.0, 2), rng, velocity=velocity)
        result = estimate(window, model, NOW_S, kinematic=True, params=LaterationParams())
        assert isinstance(result, Estimate)
        if result.velocity_chi2 is not None:
            state = with_velocity(state, 100.0 + k, result.velocity_chi2)
        state = decided(state, 100.0 + k, PARAMS)
        modes.append(state.mode)
    return modes


def test_levels_alone_rarely_claim_motion_that_is_not_there():
    modes = modes_from_levels((0.0, 0.0), 400, seed=3)
    assert np.mean([m is MotionMode.WALKING for m in modes]) <= 0.05


def test_levels_alone_see_fast_motion():
    still = np.mean([m is MotionMode.WALKING for m in modes_from_levels((0.0, 0.0), 200, seed=4)])
    fast = np.mean([m is MotionMode.WALKING for m in modes_from_levels((2.5, 1.5), 200, seed=4)])
    assert fast > still + 0.4


def test_split_blocks_give_the_same_variance():
    rng = np.random.default_rng(5)
    whole = block(100.0, walking=True, rng=rng, seconds=2.0)
    state = with_acceleration(MotionState(), whole, PARAMS)
    first = replace(whole, acc_mps2=whole.acc_mps2[:37])
    second = replace(whole, time_s=100.0 + 37 / RATE_HZ, acc_mps2=whole.acc_mps2[37:])
    split = with_acceleration(with_acceleration(MotionState(), first, PARAMS), second, PARAMS)
    assert split.acc_variance_m2ps4 == pytest.approx(state.acc_variance_m2ps4, rel=1e-12)
