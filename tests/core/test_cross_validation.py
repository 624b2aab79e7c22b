"""Calibrations checked at places that were left out."""

import numpy as np

from app.core.radio.calibration import CalibrationParams, LabelledLevels, calibrate, residuals_db
from app.core.radio.cross_validation import (
    at_the_mean,
    careful,
    cross_validate,
    folds_by_place,
)
from app.core.types import Anchor

PARAMS = CalibrationParams()
ANCHORS = tuple(
    Anchor(f"a{i}", (f"k{i}",), "f", x, y, 2.5)
    for i, (x, y) in enumerate([(0.0, 0.0), (24.0, 0.0), (24.0, 18.0), (0.0, 18.0), (12.0, 9.0)])
)


def heard(extra_db: tuple[float, ...], noise_db: float, seed: int) -> LabelledLevels:
    """All anchors on a grid of 2 m: alike (-60 dBm, exponent 2) but for what is extra."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(1.0, 24, 2), np.arange(1.0, 18, 2)))
    index = np.repeat(np.arange(len(ANCHORS)), len(x))
    x, y = np.tile(x, len(ANCHORS)), np.tile(y, len(ANCHORS))
    places = np.array([(a.x_m, a.y_m) for a in ANCHORS])[index]
    apart = np.sqrt((x - places[:, 0]) ** 2 + (y - places[:, 1]) ** 2 + 2.5**2)
    level = -60.0 + np.array(extra_db)[index] - 20.0 * np.log10(apart)
    noise = rng.normal(0.0, noise_db, len(x))
    return LabelledLevels(index, np.zeros_like(index), x, y, level + noise)


def test_neighbouring_cells_are_in_different_folds() -> None:
    x, y = np.array([1.0, 4.0, 1.0, 1.5]), np.array([1.0, 1.0, 4.0, 1.5])
    fold = folds_by_place(x, y)
    assert fold[0] == fold[3]
    assert len({fold[0], fold[1], fold[2]}) == 3


def test_an_anchor_unlike_the_others_keeps_its_own_model_and_the_others_do_not() -> None:
    fit, checked = careful(heard((0.0, 0.0, 9.0, 0.0, 0.0), 4.0, 1), ANCHORS, PARAMS)
    assert checked.is_own_better[2]
    assert fit.ref_level_dbm[2] > fit.mean_ref_level_dbm + 4.0
    held = ~checked.is_own_better
    assert np.all(fit.ref_level_dbm[held] == fit.mean_ref_level_dbm)
    assert np.all(fit.path_loss_exponent[held] == fit.mean_exponent)


def test_no_anchor_is_much_worse_elsewhere_than_with_the_mean() -> None:
    def worst_ratio(fit, asked) -> float:
        own, mean = (
            np.bincount(asked.anchor_index, residuals_db(asked, ANCHORS, which, PARAMS) ** 2)
            for which in (fit, at_the_mean(fit))
        )
        return float(np.sqrt(np.max(own / mean)))

    careful_ratios, plain_ratios = [], []
    for seed in range(5):
        levels, asked = heard((0.0,) * 5, 6.0, seed), heard((0.0,) * 5, 6.0, 100 + seed)
        careful_ratios.append(worst_ratio(careful(levels, ANCHORS, PARAMS)[0], asked))
        plain_ratios.append(worst_ratio(calibrate(levels, ANCHORS, PARAMS), asked))
    assert np.mean(careful_ratios) < np.mean(plain_ratios)
    assert np.mean(careful_ratios) < 1.02


def test_levels_are_predicted_without_themselves() -> None:
    levels = heard((0.0,) * 5, 4.0, 3)
    spoilt = levels.rssi_dbm.copy()
    spoilt[0] += 40.0
    other = LabelledLevels(levels.anchor_index, levels.phone_index, levels.x_m, levels.y_m, spoilt)
    before, after = (cross_validate(each, ANCHORS, PARAMS) for each in (levels, other))
    # Its own prediction does not move with it, those of other folds do.
    assert np.isclose(after.own_db[0] - before.own_db[0], 40.0, atol=1e-6)
    assert not np.allclose(after.own_db[1:], before.own_db[1:])
