"""Blending of speed and heading, and the fit of its weights."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.fusion.blending import (
    BlendedMotion,
    BlendingParams,
    SensedMotion,
    WifiFix,
    blended,
    blended_heading_rad,
)
from app.core.fusion.blending_weights import (
    LabelledEpoch,
    Unidentified,
    WeightFit,
    fit_weights,
    labelled,
)

PLANTED = BlendingParams((0.25, 0.3, 0.4), (0.1, 0.15, 0.75))


def test_the_equations_as_published() -> None:
    # Eastward all three, so only the speeds are blended: 0.2 * 1 + 0.38 * 3 / 2 + 0.3 * (1 + 0.5).
    motion = BlendedMotion(10.0, 4.0, 7.0, speed_mps=1.0, heading_rad=0.0)
    after = blended(
        motion, WifiFix(12.0, 7.0, 7.0), SensedMotion(0.0, acceleration_mps2=0.25), BlendingParams()
    )
    assert after.speed_mps == pytest.approx(0.2 + 0.57 + 0.45)
    assert (after.x_m, after.y_m) == pytest.approx((4.0 + 2.0 * 1.22, 7.0))
    assert after.speeds == pytest.approx((1.0, 1.5, 1.5))
    assert after.time_s == 12.0


def test_a_fix_behind_the_walker_slows_him_and_one_beside_him_does_not() -> None:
    motion = BlendedMotion(0.0, 0.0, 0.0, speed_mps=1.0, heading_rad=0.0)
    ahead = SensedMotion(0.0, speed_mps=1.0)
    straight = BlendingParams(heading_weights=(0.0, 0.0, 1.0))
    behind = blended(motion, WifiFix(1.0, -2.0, 0.0), ahead, straight)
    assert behind.speed_mps == pytest.approx(0.2 - 0.76 + 0.3)
    beside = blended(motion, WifiFix(1.0, 1.0, 9.0), ahead, straight)
    assert beside.speed_mps == pytest.approx(0.2 + 0.38 + 0.3)


angles = st.floats(-20.0, 20.0)
shares = st.floats(0.0, 1.0)


@given(angles, st.floats(-3.0, 3.0), shares)
def test_headings_are_blended_as_vectors_whatever_the_turn(
    first: float, apart: float, share: float
) -> None:
    headings = (first, first, first + apart)
    weights = (0.5 * (1.0 - share), 0.5 * (1.0 - share), share)
    here = blended_heading_rad(headings, weights)
    turned = blended_heading_rad([h + 1.0 + 2.0 * math.pi for h in headings], weights)
    assert math.cos(turned - here - 1.0) == pytest.approx(1.0)
    # Between the two on the shorter way: never farther from either than they are apart.
    assert math.cos(here - first) >= math.cos(apart) - 1e-9


def test_a_heading_that_nobody_knows_does_not_count() -> None:
    unknown = (math.nan, 1.0, math.nan)
    assert blended_heading_rad(unknown, (0.01, 0.01, 0.98)) == pytest.approx(1.0)


def winding_walk(count: int, params: BlendingParams, noise_m: float) -> list[LabelledEpoch]:
    """A walk that obeys its weights: what a labelled walk would be if the system were perfect."""
    rng = np.random.default_rng(5)
    motion = BlendedMotion(0.0, 0.0, 0.0, 1.0, 0.0)
    place = np.zeros(2)
    epochs = []
    for i in range(1, count):
        turn_rad = 0.4 * math.sin(i / 4.0)
        fix = WifiFix(float(i), *(place + rng.normal(0.0, 3.0, 2)))
        sensed = SensedMotion(
            motion.heading_rad + turn_rad + rng.normal(0.0, 0.3), rng.normal(0.0, 0.5)
        )
        after = blended(motion, fix, sensed, params)
        here = np.array([after.x_m, after.y_m]) + rng.normal(0.0, noise_m, 2)
        epochs.append(labelled(motion, after, place, here))
        motion, place = after, np.array([after.x_m, after.y_m])
    return epochs


def test_planted_weights_come_back_exactly_from_an_exact_walk() -> None:
    fit = fit_weights(winding_walk(60, PLANTED, 0.0))
    assert isinstance(fit.speed, WeightFit)
    assert isinstance(fit.heading, WeightFit)
    assert fit.speed.weights == pytest.approx(PLANTED.speed_weights, abs=1e-9)
    assert fit.heading.weights == pytest.approx(PLANTED.heading_weights, abs=1e-9)
    assert fit.onto(BlendingParams()).speed_weights == fit.speed.weights


def test_planted_weights_come_back_within_their_errors_from_a_noisy_walk() -> None:
    fit = fit_weights(winding_walk(2000, PLANTED, 0.03))
    for found, planted in (
        (fit.speed, PLANTED.speed_weights),
        (fit.heading, PLANTED.heading_weights),
    ):
        assert isinstance(found, WeightFit)
        assert 0.0 < max(found.sigmas) < 0.1
        off = np.abs(np.subtract(found.weights, planted)) / found.sigmas
        assert off.max() < 4.0


def test_a_straight_walk_at_one_pace_cannot_tell_the_weights_and_says_which() -> None:
    # V_last and V_sensor are the same number, O_last and O_sensor too: only their sums are known.
    rng = np.random.default_rng(3)
    epochs = []
    for _ in range(100):
        wifi = rng.normal(1.2, 2.0)
        speeds, headings = (1.2, wifi, 1.2), (0.1, rng.normal(0.0, 0.5), 0.1)
        epochs.append(LabelledEpoch(speeds, headings, 0.3 * wifi + 0.6 * 1.2, 0.12))
    fit = fit_weights(epochs)
    for found in (fit.speed, fit.heading):
        assert isinstance(found, Unidentified)
        assert abs(found.trade[0]) == pytest.approx(math.sqrt(0.5), abs=0.01)
        assert abs(found.trade[2]) == pytest.approx(math.sqrt(0.5), abs=0.01)
        assert found.trade[1] == pytest.approx(0.0, abs=0.01)
    assert fit.onto(PLANTED) == PLANTED


def test_a_walk_that_hardly_changes_its_pace_tells_too_little() -> None:
    rng = np.random.default_rng(3)
    epochs = []
    for _ in range(100):
        last, wifi = 1.2 + rng.normal(0.0, 0.05), rng.normal(1.2, 2.0)
        speeds = (last, wifi, last + rng.normal(0.0, 0.05))
        true_mps = np.dot(PLANTED.speed_weights, speeds) + rng.normal(0.0, 0.5)
        epochs.append(LabelledEpoch(speeds, (0.1, 0.2, 0.3), float(true_mps), 0.2))
    assert isinstance(fit_weights(epochs).speed, Unidentified)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_epochs_tell_nothing(count: int) -> None:
    fit = fit_weights(winding_walk(60, PLANTED, 0.0)[:count])
    assert isinstance(fit.speed, Unidentified)
    assert fit.speed.epochs == count


def test_epochs_that_lack_a_source_are_passed_over() -> None:
    known = winding_walk(60, PLANTED, 0.0)
    lacking = LabelledEpoch((1.0, 1.0, 1.0), (math.nan, 1.0, math.nan), 9.0, 1.0)
    with_it, without = fit_weights([*known, lacking]), fit_weights(known)
    assert with_it.heading == without.heading
    assert with_it.speed != without.speed
