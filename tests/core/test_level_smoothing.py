"""The jump-adaptive filter of a transmitter's level."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.radio.level_smoothing import (
    LevelMemory,
    LevelSmoothingParams,
    Measurement,
    SmoothedLevel,
    first_level,
    jump_measure,
    listen,
    next_level,
)
from app.storage.codec import TreeCodec

PARAMS = LevelSmoothingParams()
PLAIN = replace(PARAMS, jump_ratio=float("inf"))
SETTLED = 100


def filtered(levels_dbm: np.ndarray, params: LevelSmoothingParams) -> list[SmoothedLevel]:
    filters = [first_level(float(levels_dbm[0]), params)]
    for level_dbm in levels_dbm[1:].tolist():
        filters.append(next_level(filters[-1], level_dbm, params))
    return filters


def estimates_dbm(levels_dbm: np.ndarray, params: LevelSmoothingParams) -> np.ndarray:
    return np.array([each.level_dbm for each in filtered(levels_dbm, params)])


def stepping(step_db: float, noise_db: float, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, noise_db, SETTLED + 8)
    return -70.0 + step_db * (np.arange(SETTLED + 8) >= SETTLED) + noise


@pytest.mark.parametrize("step_db", [10.0, -10.0])
def test_a_step_of_ten_decibels_is_followed_within_eight_samples(step_db: float) -> None:
    levels_dbm = stepping(step_db, 0.0, 0)
    assert estimates_dbm(levels_dbm, PARAMS)[-1] == pytest.approx(-70.0 + step_db, abs=0.5)
    # The plain filter still lacks a third of it.
    assert abs(estimates_dbm(levels_dbm, PLAIN)[-1] - (-70.0 + step_db)) > 3.0


@pytest.mark.parametrize("noise_db", [0.55, 3.0])
def test_it_follows_through_noise(noise_db: float) -> None:
    ends = np.array([estimates_dbm(stepping(10.0, noise_db, s), PARAMS)[-1] for s in range(100)])
    assert np.mean(ends) == pytest.approx(-60.0, abs=0.6)
    assert np.mean(np.abs(ends + 60.0) < max(noise_db, 1.0)) > 0.9


@pytest.mark.parametrize("noise_db", [0.55, 1.0, 2.0, 3.0])
def test_at_rest_it_varies_as_little_as_the_plain_filter(noise_db: float) -> None:
    levels_dbm = -70.0 + np.random.default_rng(7).normal(0.0, noise_db, 20_000)
    adaptive, plain = (
        np.var(estimates_dbm(levels_dbm, params)[SETTLED:]) for params in (PARAMS, PLAIN)
    )
    assert adaptive <= 1.2 * plain


def test_its_variance_settles_where_it_is_said_to() -> None:
    settled = filtered(np.full(SETTLED, -70.0), PARAMS)[-1]
    assert settled.variance_db2 == pytest.approx(PARAMS.settled_variance_db2, rel=1e-6)


def test_one_measurement_alone_is_no_jump() -> None:
    settled = filtered(np.full(SETTLED, -70.0), PARAMS)[-1]
    assert next_level(settled, -85.0, PARAMS).level_dbm > -72.0


def test_a_jump_just_handled_is_not_found_again() -> None:
    filters = filtered(np.append(np.full(SETTLED, -70.0), np.full(20, -50.0)), PARAMS)[SETTLED:]
    assert sum(len(each.recent_dbm) == 1 for each in filters) == 1
    # Just after a jump the same distance speaks less of another.
    settled, jumped = filtered(np.full(SETTLED, -70.0), PARAMS)[-1], first_level(-70.0, PARAMS)
    far = (-60.0,)
    assert jump_measure(jumped, far, PARAMS) < 0.2 * jump_measure(settled, far, PARAMS)


def test_it_remembers_no_more_than_it_needs() -> None:
    levels_dbm = np.arange(20.0) * 0.1 - 70.0
    assert filtered(levels_dbm, PARAMS)[-1].recent_dbm == pytest.approx(levels_dbm[-8:])


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.lists(st.integers(-100, -30).map(float), min_size=1, max_size=60))
def test_the_estimate_stays_among_the_levels(levels: list[float]) -> None:
    for each in filtered(np.array(levels), PARAMS):
        assert min(levels) - 1e-9 <= each.level_dbm <= max(levels) + 1e-9
        assert 0.0 < each.variance_db2 < PARAMS.measurement_variance_db2


def test_a_stored_filter_goes_on_bit_for_bit() -> None:
    before = filtered(stepping(10.0, 2.0, 5), PARAMS)[-1]
    codec = TreeCodec(SmoothedLevel)
    restored = codec.decode(codec.encode(before))
    assert restored == before
    assert next_level(restored, -61.7, PARAMS) == next_level(before, -61.7, PARAMS)


def test_each_transmitter_has_its_own_filter() -> None:
    memory = listen(LevelMemory({}), [Measurement("a", 0.0, -60.0)], 0.0, 5.0, PARAMS)
    heard = [Measurement("b", 1.0, -80.0), Measurement("a", 1.0, -64.0)]
    memory = listen(memory, heard, 1.0, 5.0, PARAMS)
    assert memory.by_key["b"].smoothed == first_level(-80.0, PARAMS)
    expected = next_level(first_level(-60.0, PARAMS), -64.0, PARAMS)
    assert memory.by_key["a"].smoothed == expected


def test_the_same_measurement_told_again_counts_once() -> None:
    once = listen(LevelMemory({}), [Measurement("a", 10.0, -60.0)], 10.0, 5.0, PARAMS)
    again = listen(once, [Measurement("a", 10.0 + 1e-7, -60.0)], 12.0, 5.0, PARAMS)
    assert again == once


def test_a_transmitter_that_fell_silent_is_forgotten_and_begins_anew() -> None:
    memory = listen(LevelMemory({}), [Measurement("a", 0.0, -60.0)], 0.0, 5.0, PARAMS)
    assert "a" in listen(memory, [], 5.0, 5.0, PARAMS).by_key
    assert "a" not in listen(memory, [], 5.1, 5.0, PARAMS).by_key
    later = listen(memory, [Measurement("a", 6.0, -80.0)], 6.0, 5.0, PARAMS)
    assert later.by_key["a"].smoothed == first_level(-80.0, PARAMS)


def test_a_measurement_that_is_old_already_is_not_heard() -> None:
    stale = [Measurement("a", 0.0, -60.0)]
    assert not listen(LevelMemory({}), stale, 30.0, 5.0, PARAMS).by_key


def test_the_order_of_a_scan_is_irrelevant() -> None:
    heard = [Measurement(key, t, -60.0 - t) for key in "ab" for t in (0.0, 1.0, 2.0)]
    forward = listen(LevelMemory({}), heard, 2.0, 5.0, PARAMS)
    assert listen(LevelMemory({}), heard[::-1], 2.0, 5.0, PARAMS) == forward
