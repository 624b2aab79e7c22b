"""Calibration of anchors from levels at known places."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.radio.calibration import CalibrationParams, LabelledLevels, calibrate, calibrated
from app.core.radio.path_loss import expected_levels, level_model
from app.core.types import Anchor

PLACES = ((0.0, 0.0), (12.0, 0.0), (12.0, 9.0), (0.0, 9.0), (6.0, 4.0))
LEVELS_DBM = (-58.0, -60.0, -55.0, -59.0, -63.0)
EXPONENTS = (1.8, 2.2, 2.0, 2.6, 1.9)
NOISE_DB = 4.0


def true_anchors() -> tuple[Anchor, ...]:
    return tuple(
        Anchor(f"a{i}", (f"k{i}",), "f", x, y, 2.5, level, 1.0, exponent)
        for i, ((x, y), level, exponent) in enumerate(
            zip(PLACES, LEVELS_DBM, EXPONENTS, strict=True)
        )
    )


def heard(anchors, readings, *, noise_db=NOISE_DB, offsets_db=(0.0,), seed=1) -> LabelledLevels:
    """``readings`` per anchor at random places, by phones in turn."""
    rng = np.random.default_rng(seed)
    index = np.repeat(np.arange(len(anchors)), readings)
    x, y = rng.uniform(0.0, 12.0, len(index)), rng.uniform(0.0, 9.0, len(index))
    phone = np.arange(len(index)) % len(offsets_db)
    levels = expected_levels(level_model(anchors, 1.2), x, y)[np.arange(len(index)), index]
    noisy = levels + np.array(offsets_db)[phone] + rng.normal(0.0, noise_db, len(index))
    return LabelledLevels(index, phone, x, y, noisy)


PARAMS = CalibrationParams(phone_height_m=1.2)


def test_without_noise_and_with_many_readings_the_truth_comes_back() -> None:
    anchors = true_anchors()
    found = calibrate(heard(anchors, 200, noise_db=0.0), anchors, PARAMS)
    np.testing.assert_allclose(found.ref_level_dbm, LEVELS_DBM, atol=0.01)
    np.testing.assert_allclose(found.path_loss_exponent, EXPONENTS, atol=0.002)
    assert found.residual_db < 0.01


def test_with_noise_level_slope_and_noise_are_near_the_truth() -> None:
    anchors = true_anchors()
    found = calibrate(heard(anchors, 400), anchors, PARAMS)
    np.testing.assert_allclose(found.ref_level_dbm, LEVELS_DBM, atol=2.0)
    np.testing.assert_allclose(found.path_loss_exponent, EXPONENTS, atol=0.25)
    np.testing.assert_allclose(found.shadowing_db, NOISE_DB, rtol=0.1)
    assert found.residual_db == pytest.approx(NOISE_DB, rel=0.05)


def test_few_readings_stay_near_the_floors_mean_and_beat_least_squares() -> None:
    anchors = true_anchors()
    shrunk_m, alone_m = [], []
    loose = replace(PARAMS, level_spread_db=1e3, exponent_spread_ratio=1e3, spread_weight=1e3)
    for seed in range(30):
        levels = heard(anchors, 4, seed=seed)
        for params, errors in ((PARAMS, shrunk_m), (loose, alone_m)):
            found = calibrate(levels, anchors, params)
            errors.append(np.abs(found.path_loss_exponent - EXPONENTS).mean())
    assert np.mean(shrunk_m) < 0.6 * np.mean(alone_m)


def test_an_anchor_that_was_never_heard_gets_the_floors_mean() -> None:
    anchors = true_anchors()
    levels = heard(anchors[:4], 100)
    found = calibrate(levels, anchors, PARAMS)
    assert found.readings.tolist() == [100, 100, 100, 100, 0]
    assert found.ref_level_dbm[4] == pytest.approx(found.mean_ref_level_dbm)
    assert found.path_loss_exponent[4] == pytest.approx(found.mean_exponent)
    assert found.shadowing_db[4] == pytest.approx(found.residual_db, rel=0.1)


def test_phones_offsets_are_told_apart_from_levels() -> None:
    anchors = true_anchors()
    levels = heard(anchors, 300, noise_db=2.0, offsets_db=(6.0, -6.0, 0.0))
    found = calibrate(levels, anchors, PARAMS)
    np.testing.assert_allclose(found.offset_db, [6.0, -6.0, 0.0], atol=0.7)
    np.testing.assert_allclose(found.ref_level_dbm, LEVELS_DBM, atol=2.0)


def test_a_wall_that_hides_the_slope_does_not_turn_it_round() -> None:
    anchors = (Anchor("a", ("k",), "f", 0.0, 0.0),)
    x = np.array([1.0, 2.0, 4.0, 8.0])
    zeros = np.zeros(4, dtype=np.int64)
    # Louder with distance.
    levels = LabelledLevels(zeros, zeros, x, np.zeros(4), np.array([-70.0, -68.0, -66.0, -64.0]))
    found = calibrate(levels, anchors, CalibrationParams())
    assert found.path_loss_exponent[0] == 1.0
    expected = found.ref_level_dbm[0] - 10.0 * np.log10(x)
    assert np.mean(levels.rssi_dbm - expected) == pytest.approx(0.0, abs=1e-9)


def test_one_distance_cannot_calibrate() -> None:
    anchors = (Anchor("a", ("k",), "f", 0.0, 0.0),)
    zeros, ones = np.zeros(5, dtype=np.int64), np.ones(5)
    with pytest.raises(ValueError, match="two different distances"):
        calibrate(LabelledLevels(zeros, zeros, ones, ones, -60.0 * ones), anchors, PARAMS)


def test_calibrated_anchors_keep_everything_else() -> None:
    anchors = true_anchors()
    plain = tuple(replace(a, ref_level_dbm=-59.0, path_loss_exponent=2.0) for a in anchors)
    found = calibrate(heard(anchors, 200, noise_db=0.0), plain, PARAMS)
    result = calibrated(plain, found)
    assert [(a.keys, a.x_m, a.z_m) for a in result] == [(a.keys, a.x_m, a.z_m) for a in anchors]
    np.testing.assert_allclose([a.ref_level_dbm for a in result], LEVELS_DBM, atol=0.01)
