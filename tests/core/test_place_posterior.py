"""Lateration by the posterior: walls, faults, the phone's offset, the power of many readings."""

import numpy as np
import pytest
from lateration_room import CORNERS, NOW_S, anchors_at, corners_and_middles, window_at

from app.core.lateration.posterior import (
    PhoneOffset,
    PlacePosterior,
    PlacePrior,
    local_levels,
    place_posterior,
)
from app.core.lateration.surface import box_around, corners_around
from app.core.radio.local_mean import local_means_dbm
from app.core.radio.path_loss import X, Y, expected_levels, level_model
from app.core.radio.wall_losses import NO_LOSS, loss_at, loss_map_db, wall_losses_db
from app.core.radio.windows import Window, window_of

EXACT = PhoneOffset(0.0, 0.0)
UNKNOWN = PhoneOffset(0.0, 10.0)


def located(window: Window, model, offset=EXACT, loss_db=None, plan_m=None) -> PlacePosterior:
    levels = local_levels(window, model, 0.0)
    places = corners_around(model.table[:, X : Y + 1])
    prior = PlacePrior(box_around(places, 4.0))
    if plan_m is not None:
        prior = PlacePrior(prior.box, np.array(plan_m))
    return place_posterior(levels, model, loss_db or [NO_LOSS] * len(model.table), offset, prior)


def error_m(found: PlacePosterior, place) -> float:
    return float(np.hypot(*(found.mean - place)))


def test_the_truth_is_where_the_posterior_says_it_is() -> None:
    model, rng, place = corners_and_middles(), np.random.default_rng(1), (3.0, 6.5)
    found = [located(window_at(model, place, rng, epochs=4), model) for _ in range(150)]
    apart = np.array([f.mean - place for f in found])
    far = [a @ np.linalg.solve(f.covariance, a) for a, f in zip(apart, found, strict=True)]
    assert np.hypot(*apart.T).mean() < 1.6
    assert 0.90 <= np.mean(np.array(far) < 5.99) <= 0.99


@pytest.mark.parametrize("offset_db", [-10.0, 10.0])
def test_a_phone_of_unknown_offset_is_located_and_its_offset_found(offset_db) -> None:
    model, rng, place = corners_and_middles(), np.random.default_rng(2), (4.0, 5.5)
    window = window_at(model, place, rng, offset_db=offset_db, noise_db=2.0)
    assert error_m(located(window, model, UNKNOWN), place) < 1.0
    assert located(window, model, UNKNOWN).offset.mean_db == pytest.approx(offset_db, abs=2.0)
    assert error_m(located(window, model, EXACT), place) > 1.2


def test_an_anchor_that_was_moved_hardly_moves_the_place() -> None:
    model, rng, place = corners_and_middles(), np.random.default_rng(3), (3.0, 3.0)
    window = window_at(model, place, rng, noise_db=2.0)
    moved = window_of(
        window.anchor_index,
        window.time_s,
        window.rssi_dbm - np.where(window.anchor_index == 0, 30.0, 0.0),
    )
    assert error_m(located(moved, model), place) < error_m(located(window, model), place) + 0.5


def test_nobody_is_outside_the_plan() -> None:
    model = level_model(anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0))))
    window = window_at(model, (5.0, 3.0), np.random.default_rng(4), noise_db=1.0)
    both_sides = located(window, model)
    inside = located(window, model, plan_m=(0.0, 0.0, 10.0, 8.0))
    assert abs(both_sides.mean[1]) < 0.5
    assert inside.mean[1] == pytest.approx(3.0, abs=0.8)


def test_walls_are_taken_into_account() -> None:
    places = CORNERS
    model, place = level_model(anchors_at(CORNERS)), (3.5, 6.5)
    walls = np.array([(5.0, -1.0, 5.0, 11.0, 8.0)])
    loss_db = [loss_map_db(walls, anchor) for anchor in places]
    window = window_at(model, place, np.random.default_rng(5), noise_db=1.0)
    behind = np.array([wall_losses_db(walls, a, *np.array(place)[:, None])[0] for a in places])
    heard = window_of(
        window.anchor_index, window.time_s, window.rssi_dbm - behind[window.anchor_index]
    )
    known = error_m(located(heard, model, EXACT, loss_db), place)
    assert known < 0.3
    assert error_m(located(heard, model), place) > known + 0.2


def test_losses_add_up_to_a_bound_and_the_map_repeats_them() -> None:
    walls = np.array([(x, -5.0, x, 5.0, 6.0) for x in (1.1, 2.1, 3.1, 4.1, 5.1)])
    x_m = np.array([0.5, 1.5, 2.5, 3.5, 8.0, -3.0])
    losses = wall_losses_db(walls, (0.0, 0.0), x_m, np.zeros(6))
    assert losses.tolist() == [0.0, 6.0, 12.0, 18.0, 20.0, 0.0]
    loss_map = loss_map_db(walls, (0.0, 0.0))
    assert [loss_at(loss_map, x, 0.0) for x in x_m] == losses.tolist()
    assert loss_at(loss_map, 500.0, 0.0) == 20.0
    assert loss_map_db(walls + 500.0 * np.array([1, 0, 1, 0, 0]), (0.0, 0.0)) is NO_LOSS


def test_the_local_mean_is_one_of_power() -> None:
    rng = np.random.default_rng(6)
    # Rayleigh fading: the power is exponential, its mean one.
    faded_dbm = -60.0 + 10.0 * np.log10(rng.exponential(size=4000))
    mean_dbm = local_means_dbm(np.zeros(4000, dtype=np.int64), faded_dbm, 1)
    assert mean_dbm[0] == pytest.approx(-60.0, abs=0.2)
    assert faded_dbm.mean() < -62.0
    two = local_means_dbm(np.array([0, 0, 1]), np.array([-50.0, -90.0, -70.0]), 3)
    assert two[:2] == pytest.approx([-53.0, -70.0], abs=0.02)
    assert two[2] == -np.inf


def test_displacement_since_a_level_is_undone() -> None:
    model, rng, velocity = corners_and_middles(), np.random.default_rng(7), (1.5, 0.0)
    window = window_at(model, (6.0, 5.0), rng, velocity=velocity, noise_db=1.0)
    levels = local_levels(window, model, 0.0)
    moved = np.outer(NOW_S - levels.time_s, velocity)
    told = type(levels)(
        levels.anchor_index, levels.level_dbm, levels.sigma_db, levels.time_s, moved
    )
    prior = PlacePrior(box_around(corners_around(model.table[:, X : Y + 1]), 4.0))
    loss_db = [NO_LOSS] * len(model.table)
    assert error_m(place_posterior(told, model, loss_db, EXACT, prior), (6.0, 5.0)) < 0.4
    assert error_m(place_posterior(levels, model, loss_db, EXACT, prior), (6.0, 5.0)) > 1.0
    assert np.isfinite(expected_levels(model, np.array([6.0]), np.array([5.0]))).all()
