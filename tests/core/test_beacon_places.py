"""Places of beacons from levels at known places."""

import numpy as np
import pytest

from app.core.radio.beacon_places import BeaconPlaces, BeaconPlacesParams, beacon_places
from app.core.radio.calibration import LabelledLevels

PARAMS = BeaconPlacesParams()
TRUE = np.array([(5.0, 4.0), (18.0, 9.0), (26.0, 3.0), (12.0, 14.0), (2.0, 12.0), (22.0, 15.0)])
LEVELS_DBM = np.array([-60.0, -64.0, -58.0, -62.0, -66.0, -61.0])


def survey(
    noise_db: float, seed: int, *, grid_m: float = 3.0, outliers: float = 0.0
) -> LabelledLevels:
    """Levels of all beacons on a grid over 28 by 16 m."""
    rng = np.random.default_rng(seed)
    x, y = (
        axis.ravel() for axis in np.meshgrid(np.arange(0, 29, grid_m), np.arange(0, 17, grid_m))
    )
    index = np.repeat(np.arange(len(TRUE)), len(x))
    x, y = np.tile(x, len(TRUE)), np.tile(y, len(TRUE))
    apart = np.sqrt((x - TRUE[index, 0]) ** 2 + (y - TRUE[index, 1]) ** 2 + PARAMS.height_m**2)
    level = LEVELS_DBM[index] - 22.0 * np.log10(apart) + rng.normal(0.0, noise_db, len(x))
    level -= np.where(rng.random(len(x)) < outliers, 15.0, 0.0)
    return LabelledLevels(index, np.zeros_like(index), x.astype(float), y.astype(float), level)


def errors_m(found: BeaconPlaces) -> np.ndarray:
    return np.hypot(found.x_m - TRUE[:, 0], found.y_m - TRUE[:, 1])


def test_without_noise_the_places_come_back() -> None:
    found = beacon_places(survey(0.1, 0), len(TRUE), PARAMS)
    assert errors_m(found).max() < 0.2
    np.testing.assert_allclose(found.ref_level_dbm, LEVELS_DBM, atol=0.5)


def test_the_covariance_holds_the_truth_as_often_as_it_says() -> None:
    inside, total = 0, 0
    for seed in range(5):
        found = beacon_places(survey(5.0, seed), len(TRUE), PARAMS)
        off = np.column_stack([found.x_m, found.y_m]) - TRUE
        distance2 = [
            o @ np.linalg.solve(c, o) for o, c in zip(off, found.covariance_m2, strict=True)
        ]
        inside, total = inside + int(np.sum(np.array(distance2) <= 5.99)), total + len(TRUE)
    assert 0.85 <= inside / total <= 1.0


def test_levels_behind_shelves_do_not_carry_a_place_away() -> None:
    mean_m = [
        errors_m(beacon_places(survey(2.0, seed, outliers=0.15), len(TRUE), PARAMS)).mean()
        for seed in range(3)
    ]
    # The same levels, each believed alike: nearly normal residuals.
    normal = BeaconPlacesParams(student_dof=1e6)
    believed_m = [
        errors_m(beacon_places(survey(2.0, seed, outliers=0.15), len(TRUE), normal)).mean()
        for seed in range(3)
    ]
    assert np.mean(mean_m) < 0.8 * np.mean(believed_m)


def test_repeated_shadowing_does_not_halve_the_covariances_width() -> None:
    # Each level of a wide grid four times, moved by centimetres: nothing new is told.
    once = survey(5.0, 3, grid_m=6.0)
    again = LabelledLevels(
        *(np.tile(a, 4) for a in (once.anchor_index, once.phone_index)),
        np.tile(once.x_m, 4) + np.repeat((0.0, 0.05, 0.1, 0.15), len(once.x_m)),
        *(np.tile(a, 4) for a in (once.y_m, once.rssi_dbm)),
    )
    sigma = [
        np.sqrt(np.trace(found.covariance_m2, axis1=1, axis2=2)).mean()
        for found in (beacon_places(levels, len(TRUE), PARAMS) for levels in (once, again))
    ]
    assert sigma[1] > 0.7 * sigma[0]


def test_a_beacon_heard_twice_has_no_place_but_the_floors_model() -> None:
    levels = survey(3.0, 1)
    kept = (levels.anchor_index != 4) | (np.cumsum(levels.anchor_index == 4) <= 2)
    few = LabelledLevels(
        *(
            column[kept]
            for column in (
                levels.anchor_index,
                levels.phone_index,
                levels.x_m,
                levels.y_m,
                levels.rssi_dbm,
            )
        )
    )
    found = beacon_places(few, len(TRUE), PARAMS)
    assert np.isnan(found.x_m[4])
    assert np.isnan(found.covariance_m2[4]).all()
    assert found.levels[4] == 2
    assert found.ref_level_dbm[4] == pytest.approx(LEVELS_DBM.mean(), abs=3.0)
    assert not np.isnan(np.delete(found.x_m, 4)).any()


def test_nothing_heard_places_nobody() -> None:
    none = np.empty(0)
    levels = LabelledLevels(none.astype(np.int64), none.astype(np.int64), none, none, none)
    found = beacon_places(levels, 2, PARAMS)
    assert np.isnan(found.x_m).all()
