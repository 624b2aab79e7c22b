"""The scheduled-variance filter: every branch of its schedule, the heading offset, and its laws."""

import math
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fusion.planar import PlanarTrack
from app.core.fusion.scheduled import (
    Comparison,
    ScheduledMemory,
    ScheduledParams,
    begin,
    compare,
    offset_in_force_rad,
    scheduled_variance_m2,
    update,
    walk,
)

PARAMS = ScheduledParams()
STRAIGHT = Comparison(
    walked_m=1.2,
    led_m=1.2,
    elapsed_s=1.0,
    difference_rad=0.0,
    disagreement_rad=0.0,
    is_turning=False,
)
DEG = math.pi / 180.0
State = tuple[PlanarTrack, ScheduledMemory]


def started(fix_m: tuple[float, float] = (0.0, 0.0), **remembered: object) -> State:
    """The filter with its heading offset in force, at time 100."""
    track, memory = begin(fix_m, 100.0, PARAMS)
    memory = replace(memory, began_s=90.0, steps=20)
    return track, replace(memory, **remembered)  # type: ignore[arg-type]


def strode(state: State, time_s: float, length_m: float, heading_rad: float) -> State:
    return walk(*state, (time_s, length_m, heading_rad), PARAMS)


# The schedule


@pytest.mark.parametrize(
    ("change", "variance_m2"),
    [
        pytest.param({"walked_m": 0.0, "disagreement_rad": None}, 9.0, id="no displacement"),
        pytest.param({"walked_m": 0.0, "is_turning": True}, 9.0, id="no displacement in a turn"),
        pytest.param({"disagreement_rad": None}, 999_999.0, id="the fix did not move"),
        pytest.param({"disagreement_rad": 91.0 * DEG}, 999_999.0, id="behind the walker"),
        pytest.param({"disagreement_rad": -91.0 * DEG}, 999_999.0, id="behind, the other way"),
        pytest.param({"walked_m": 8.4, "led_m": 8.4}, 999_999.0, id="over 30 km/h"),
        pytest.param({"walked_m": 8.3, "led_m": 8.3}, 109.0, id="under 30 km/h"),
        pytest.param({"walked_m": 8.4, "led_m": 8.4, "elapsed_s": 2.0}, 109.0, id="in two seconds"),
        pytest.param({"is_turning": True}, 5000.0, id="turning"),
        pytest.param({"is_turning": True, "disagreement_rad": 2.0}, 999_999.0, id="turned away"),
        pytest.param({}, 109.0, id="the fix leads as far as was walked"),
        pytest.param({"disagreement_rad": 89.0 * DEG}, 109.0, id="beside the walker"),
        pytest.param({"led_m": 2.4}, 9.0 + 100.0 * 16.0, id="leads twice as far"),
        pytest.param({"led_m": 0.6}, 9.0 + 100.0 * 16.0, id="leads half as far"),
        pytest.param({"led_m": 60.0}, 999_999.0, id="no fix counts less than a dropped one"),
    ],
)
def test_variance_of_a_fix(change: dict[str, float | bool | None], variance_m2: float) -> None:
    comparison = replace(STRAIGHT, **change)  # type: ignore[arg-type]
    assert scheduled_variance_m2(comparison, PARAMS) == pytest.approx(variance_m2)


def test_a_fix_is_compared_with_the_last_output_and_the_last_fix() -> None:
    state = started(fix_m=(3.0, 4.0), output_m=(0.0, 0.0))
    _, memory = strode(state, 100.5, 2.0, math.pi / 2.0)
    ahead = compare(memory, (5.0, 0.0), 101.0, PARAMS)
    assert (ahead.walked_m, ahead.led_m, ahead.elapsed_s) == pytest.approx((2.0, 5.0, 1.0))
    assert ahead.difference_rad == pytest.approx(-math.pi / 2.0)
    assert compare(memory, (3.0, 4.0), 101.0, PARAMS).disagreement_rad is None
    assert compare(memory, (0.0, 0.0), 101.0, PARAMS).disagreement_rad is None


def test_the_gain_follows_from_the_variance() -> None:
    """One fix at rest: P grows to 9 + 0.1, R is 9."""
    track, _ = update(*started(), (10.0, 0.0), 101.0, PARAMS)
    gain = 9.1 / 18.1
    assert track.mean == pytest.approx((10.0 * gain, 0.0))
    assert track.covariance == pytest.approx((1.0 - gain) * 9.1 * np.eye(2))


def test_a_fix_behind_the_walker_hardly_moves_the_track() -> None:
    state = strode(started(), 100.5, 1.2, 0.0)
    track, memory = update(*state, (-10.0, 0.0), 101.0, PARAMS)
    assert track.mean == pytest.approx((1.2, 0.0), abs=0.03)
    assert memory.output_m == tuple(track.mean)


# Turns


def walked_seconds(headings_rad: list[float]) -> list[ScheduledMemory]:
    """What is remembered after each second of a walk with fixes where the pedometer leads."""
    state, memories = started(), []
    place = np.zeros(2)
    for second, heading_rad in enumerate(headings_rad):
        state = strode(state, 100.5 + second, 1.2, heading_rad)
        place = place + 1.2 * np.array([math.cos(heading_rad), math.sin(heading_rad)])
        state = update(*state, (float(place[0]), float(place[1])), 101.0 + second, PARAMS)
        memories.append(state[1])
    return memories


def test_a_turn_lasts_for_the_fix_that_shows_it_and_two_seconds_more() -> None:
    memories = walked_seconds([0.0, 0.0, 14.0 * DEG, *[14.0 * DEG] * 4])
    assert [m.turned_s for m in memories] == [None, None, *[103.0] * 5]
    is_turning = [compare(m, (99.0, 0.0), m.told_s, PARAMS).is_turning for m in memories]
    assert is_turning == [False, False, True, True, True, False, False]


def test_twelve_degrees_are_no_turn() -> None:
    assert walked_seconds([0.0, 12.0 * DEG, 0.0])[-1].turned_s is None


def test_a_turn_is_known_on_either_side_of_south() -> None:
    assert walked_seconds([179.0 * DEG, -179.0 * DEG])[-1].turned_s is None
    assert walked_seconds([174.0 * DEG, -172.0 * DEG])[-1].turned_s is not None


# The heading offset


def gathered(offset_rad: float, offsets: int, difference_rad: float, **memory: object) -> float:
    """The heading offset after one more difference."""
    state = started(offset_rad=offset_rad, offsets=offsets, **memory)
    state = strode(state, 100.5, 1.0, 0.0)
    fix_m = (math.cos(difference_rad), math.sin(difference_rad))
    return update(*state, fix_m, 101.0, PARAMS)[1].offset_rad


def test_the_heading_offset_is_a_running_mean() -> None:
    assert gathered(0.0, 0, 40.0 * DEG) == pytest.approx(40.0 * DEG)
    assert gathered(10.0 * DEG, 3, 30.0 * DEG) == pytest.approx(15.0 * DEG)


def test_the_mean_is_taken_on_the_circle() -> None:
    offset_rad = gathered(179.0 * DEG, 1, -179.0 * DEG)
    assert abs(offset_rad) == pytest.approx(180.0 * DEG)


def test_in_a_turn_only_small_differences_count() -> None:
    turning = {"turned_s": 100.0}
    assert gathered(0.0, 1, 29.0 * DEG, **turning) == pytest.approx(14.5 * DEG)
    assert gathered(0.0, 1, 31.0 * DEG, **turning) == 0.0
    assert gathered(0.0, 1, 31.0 * DEG) == pytest.approx(15.5 * DEG)


def test_at_first_the_offset_is_only_gathered() -> None:
    _, memory = begin((0.0, 0.0), 100.0, PARAMS)
    memory = replace(memory, offset_rad=0.5)
    assert offset_in_force_rad(replace(memory, steps=6), 104.9, PARAMS) == 0.0
    assert offset_in_force_rad(replace(memory, steps=5), 105.0, PARAMS) == 0.0
    assert offset_in_force_rad(replace(memory, steps=6), 105.0, PARAMS) == 0.5


def test_at_first_every_fix_counts_as_normal() -> None:
    """A fix behind the walker is no reason yet: nobody knows where the phone points."""
    state = strode(begin((0.0, 0.0), 100.0, PARAMS), 100.5, 1.0, 0.0)
    track, _ = update(*state, (-9.0, 0.0), 101.0, PARAMS)
    assert track.mean[0] == pytest.approx(1.0 - 10.0 * 9.1 / 18.1)


@pytest.mark.parametrize("held_rad", [-2.5, -0.7, 0.0, 0.4, 3.0])
def test_a_phone_held_aside_is_followed(held_rad: float) -> None:
    """Exact fixes for 30 s, then none for 11 m: the turned pedometer goes on where they went."""
    state, place = begin((0.0, 0.0), 0.0, PARAMS), 0.0
    for step in range(1, 100):
        time_s, place = 0.5 * step, place + 0.6
        state = strode(state, time_s, 0.6, held_rad)
        if step % 2 == 0 and time_s <= 30.0:
            state = update(*state, (place, 0.0), time_s, PARAMS)
    assert state[0].mean == pytest.approx((place, 0.0), abs=2.0)


def test_a_step_of_unknown_heading_only_widens() -> None:
    track, memory = strode(started(), 100.5, 0.8, math.nan)
    assert track.mean == pytest.approx((0.0, 0.0))
    assert track.covariance == pytest.approx((9.0 + 0.32) * np.eye(2))
    assert (memory.walked_m, memory.steps) == ((0.0, 0.0), 21)


# Laws


def wander(seed: int, turn_rad: float = 0.0, shift_m: tuple[float, float] = (0, 0)) -> list[State]:
    """A walk with noisy fixes and steps, rests and gaps; the whole plan turned and shifted."""
    rng = np.random.default_rng(seed)
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    place, heading_rad, states = rng.uniform(-50.0, 50.0, 2), rng.uniform(-3.0, 3.0), []
    for second in range(25):
        heading_rad += rng.normal(0.0, 0.3)
        steps = int(rng.integers(0, 4))
        if states:
            for step in range(steps):
                time_s = second - 1.0 + 0.25 * (step + 1)
                states.append(strode(states[-1], time_s, 0.6, heading_rad + turn_rad))
        place = place + 0.6 * steps * np.array([math.cos(heading_rad), math.sin(heading_rad)])
        fix = turn @ (place + rng.normal(0.0, 2.0, 2)) + shift_m
        if states and rng.random() < 0.2:
            continue
        fix_m = (float(fix[0]), float(fix[1]))
        known = update(*states[-1], fix_m, float(second), PARAMS) if states else None
        states.append(begin(fix_m, float(second), PARAMS) if known is None else known)
    return states


@given(
    seed=st.integers(0, 10_000),
    turn_rad=st.floats(-3.1, 3.1),
    shift_m=st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0)),
)
@settings(max_examples=30, deadline=None)
def test_a_turned_and_shifted_plan_carries_the_track_along(
    seed: int, turn_rad: float, shift_m: tuple[float, float]
) -> None:
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    plain, moved = wander(seed), wander(seed, turn_rad, shift_m)
    for (track, _), (other, _) in zip(plain, moved, strict=True):
        assert other.mean == pytest.approx(turn @ track.mean + shift_m, abs=1e-6)
        assert other.covariance == pytest.approx(turn @ track.covariance @ turn.T, abs=1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_the_covariance_stays_symmetric_and_positive(seed: int) -> None:
    for track, _ in wander(seed):
        assert np.array_equal(track.covariance, track.covariance.T)
        assert np.linalg.eigvalsh(track.covariance).min() > 0.0


def test_nothing_that_goes_in_is_changed() -> None:
    track, memory = started()
    before = deepcopy((track.mean, track.covariance, memory))
    strode((track, memory), 100.5, 0.7, 0.3)
    update(track, memory, (2.0, 1.0), 101.0, PARAMS)
    assert np.array_equal(track.mean, before[0])
    assert np.array_equal(track.covariance, before[1])
    assert memory == before[2]
