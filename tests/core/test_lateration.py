"""Windowed least squares: the published table, its own covariance, and layouts that mislead."""

from dataclasses import replace

import numpy as np
import pytest
from lateration_room import (
    CORNERS,
    NOW_S,
    WALL_MIDDLES,
    anchors_at,
    corners,
    corners_and_middles,
    window_at,
)
from scipy import stats
from scipy.optimize import least_squares

from app.core.lateration.predicted import (
    Schedule,
    cell_centres,
    predicted_covariance,
    predicted_sigma_m,
)
from app.core.lateration.windowed import Estimate, estimate
from app.core.params import LaterationParams
from app.core.radio.path_loss import expected_levels, level_model
from app.core.radio.windows import Window, window_of
from app.core.types import NoFix, NoFixReason

PARAMS = LaterationParams()


def solve(window, model, *, kinematic=False, params=PARAMS) -> Estimate:
    result = estimate(window, model, NOW_S, kinematic=kinematic, params=params)
    assert isinstance(result, Estimate)
    return result


def matrix(fix) -> np.ndarray:
    xx, xy, yy = fix.covariance_m2
    return np.array([[xx, xy], [xy, yy]])


@pytest.mark.parametrize(
    ("layout", "kinematic", "low", "median", "high"),
    [
        (corners, False, 0.94, 1.05, 1.29),
        (corners, True, 1.83, 2.05, 2.52),
        (corners_and_middles, False, 0.44, 0.51, 0.64),
        (corners_and_middles, True, 0.85, 1.00, 1.24),
    ],
)
def test_predicted_sigma_is_the_published_table(layout, kinematic, low, median, high):
    x, y = cell_centres(10.0, 10.0, 0.5)
    sigma = predicted_sigma_m(layout(), x, y, Schedule(), kinematic=kinematic)
    assert sigma.shape == (20, 20)
    found = (sigma.min(), np.median(sigma), sigma.max())
    assert found == pytest.approx((low, median, high), abs=0.0051)


def test_at_the_middle_of_the_window_a_velocity_costs_nothing():
    x, y = cell_centres(10.0, 10.0, 2.0)
    middle = Schedule(at_s=27 * 0.07 / 2)
    kinematic = predicted_sigma_m(corners(), x, y, middle, kinematic=True)
    static = predicted_sigma_m(corners(), x, y, middle, kinematic=False)
    np.testing.assert_allclose(kinematic, static, rtol=1e-9)


def test_prediction_is_the_inverse_of_the_whole_normal_matrix():
    model, schedule = corners_and_middles(), Schedule(epochs=9, period_s=0.2, at_s=0.3)
    place = np.array([3.0]), np.array([4.0])
    tau_s = np.arange(9) * 0.2 - 0.3
    step = 1e-6
    dx = expected_levels(model, place[0] + step, place[1]) - expected_levels(model, *place)
    dy = expected_levels(model, place[0], place[1] + step) - expected_levels(model, *place)
    h = np.stack((dx[0], dy[0]), axis=1) / step
    rows = np.concatenate([np.hstack((h, h * tau)) for tau in tau_s]) / 5.0
    covariance = predicted_covariance(model, *place, schedule, kinematic=True)[0]
    np.testing.assert_allclose(covariance, np.linalg.inv(rows.T @ rows)[:2, :2], rtol=1e-4)


def test_prediction_is_infinite_where_a_direction_stays_open():
    row = level_model(anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0))))
    x, y = np.array([3.0, 3.0]), np.array([0.0, 4.0])
    on_line, beside = predicted_sigma_m(row, x, y, Schedule(), kinematic=False)
    assert np.isinf(on_line)
    assert np.isfinite(beside)
    out_of_reach = predicted_sigma_m(row, x, y, Schedule(), kinematic=False, reach_m=4.5)
    assert np.isinf(out_of_reach[0])


@pytest.mark.parametrize("layout", [corners, corners_and_middles])
@pytest.mark.parametrize("velocity", [None, (0.0, 0.0), (0.7, -0.5)])
@pytest.mark.parametrize("place", [(5.0, 5.0), (3.25, 4.25), (6.75, 3.25)])
def test_hundreds_of_windows_scatter_as_predicted(layout, velocity, place):
    model, rng, count = layout(), np.random.default_rng(20181), 400
    kinematic = velocity is not None
    fixes = [
        solve(
            window_at(model, place, rng, velocity=velocity or (0.0, 0.0)),
            model,
            kinematic=kinematic,
        ).fix
        for _ in range(count)
    ]
    errors = np.array([(f.x_m - place[0], f.y_m - place[1]) for f in fixes])
    x, y = np.array([place[0]]), np.array([place[1]])
    covariance = predicted_covariance(model, x, y, Schedule(), kinematic=kinematic)[0]
    radius2 = 4.0 * np.trace(covariance)
    ideal = np.random.default_rng(1).multivariate_normal((0.0, 0.0), covariance, 40_000)
    expected_share = np.mean((ideal**2).sum(axis=1) <= radius2)
    inside = int(np.sum((errors**2).sum(axis=1) <= radius2))
    assert inside >= stats.binom.ppf(0.001, count, expected_share - 0.02)
    # The chi-square band, widened: Huber's weights cost 5 % of the variance, and at this noise the
    # model is not linear any more (plain least squares scatters by 1.09 of D here, too).
    ratio = np.sqrt((errors**2).sum(axis=1).mean() / np.trace(covariance))
    low, high = np.sqrt(stats.chi2.ppf((0.001, 0.999), 2 * count) / (2 * count))
    assert low * 0.95 <= ratio <= high * 1.12


@pytest.mark.parametrize("kinematic", [False, True])
def test_a_fix_carries_the_predicted_covariance(kinematic):
    model, rng = corners_and_middles(), np.random.default_rng(21)
    place = np.array([4.0]), np.array([5.5])
    predicted = predicted_covariance(model, *place, Schedule(), kinematic=kinematic)[0]
    own = [
        matrix(solve(window_at(model, (4.0, 5.5), rng), model, kinematic=kinematic).fix)
        for _ in range(100)
    ]
    scale = np.trace(predicted)
    np.testing.assert_allclose(np.median(own, axis=0), predicted / 0.956, atol=0.06 * scale)


@pytest.mark.parametrize("kinematic", [False, True])
@pytest.mark.parametrize("layout", [corners, corners_and_middles])
def test_over_the_room_the_error_is_the_predicted_one(layout, kinematic):
    model, rng = layout(), np.random.default_rng(11)
    x, y = cell_centres(10.0, 10.0, 0.5)
    sigma = predicted_sigma_m(model, x, y, Schedule(), kinematic=kinematic)
    ratios, covered = [], []
    for place, predicted in zip(zip(x.flat, y.flat, strict=True), sigma.flat, strict=True):
        fix = solve(window_at(model, place, rng), model, kinematic=kinematic).fix
        error = np.array((fix.x_m - place[0], fix.y_m - place[1]))
        ratios.append(error @ error / predicted**2)
        covered.append(error @ np.linalg.solve(matrix(fix), error) < stats.chi2.ppf(0.95, 2))
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1.0, abs=0.15)
    assert np.mean(covered) >= 0.88


def test_solution_is_the_minimum_that_scipy_finds():
    model = corners_and_middles()
    window = window_at(model, (4.0, 6.0), np.random.default_rng(3), velocity=(0.8, 0.3))
    tau_s = window.time_s - NOW_S

    def residuals(state):
        levels = expected_levels(model, state[0] + state[2] * tau_s, state[1] + state[3] * tau_s)
        picked = levels[np.arange(len(window)), window.anchor_index]
        return (window.rssi_dbm - picked) / 5.0

    oracle = least_squares(residuals, (5.0, 5.0, 0.0, 0.0), loss="huber", f_scale=1.345)
    fix = solve(window, model, kinematic=True).fix
    assert (fix.x_m, fix.y_m, *fix.velocity_mps) == pytest.approx(oracle.x, abs=0.01)


def test_outlying_readings_hardly_move_the_fix():
    model, rng = corners_and_middles(), np.random.default_rng(8)
    clean = window_at(model, (4.0, 6.0), rng)
    levels = clean.rssi_dbm.copy()
    levels[::10] -= 30.0
    dirty = window_of(clean.anchor_index, clean.time_s, levels)
    before = solve(clean, model).fix
    after = solve(dirty, model).fix
    plain = solve(dirty, model, params=replace(PARAMS, huber_k=1e6)).fix
    moved = np.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    moved_plainly = np.hypot(plain.x_m - before.x_m, plain.y_m - before.y_m)
    assert moved < 0.7 * moved_plainly
    assert np.trace(matrix(after)) > np.trace(matrix(before))


@pytest.mark.parametrize("offset_db", [-10.0, 0.0, 10.0])
def test_phone_with_unknown_offset_is_located(offset_db):
    model, rng = corners_and_middles(), np.random.default_rng(4)
    params = replace(PARAMS, offset_prior_db=10.0)
    place = (4.0, 5.5)
    found = [
        solve(window_at(model, place, rng, offset_db=offset_db), model, params=params)
        for _ in range(40)
    ]
    errors = [np.hypot(e.fix.x_m - place[0], e.fix.y_m - place[1]) for e in found]
    offsets = [e.offset_db for e in found if e.offset_db is not None]
    assert np.median(errors) < 0.8
    assert np.median(offsets) == pytest.approx(offset_db, abs=1.0)


def test_four_anchors_locate_a_phone_with_unknown_offset():
    model, rng = corners(), np.random.default_rng(5)
    params = replace(PARAMS, offset_prior_db=10.0)
    for kinematic, limit_m in ((False, 1.5), (True, 2.5)):
        errors = [
            np.hypot(e.fix.x_m - 4.5, e.fix.y_m - 5.5)
            for window in (window_at(model, (4.5, 5.5), rng, offset_db=10.0) for _ in range(30))
            if (e := solve(window, model, kinematic=kinematic, params=params))
        ]
        assert np.median(errors) < limit_m


def test_an_ignored_offset_spoils_the_fix_and_an_estimated_one_does_not():
    model = level_model(anchors_at(((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (2.0, 7.0), (6.0, 3.0))))
    window = window_at(model, (8.0, 4.0), np.random.default_rng(6), offset_db=-10.0)
    ignored = solve(window, model).fix
    estimated = solve(window, model, params=replace(PARAMS, offset_prior_db=10.0)).fix
    assert np.hypot(ignored.x_m - 8.0, ignored.y_m - 4.0) > 1.5
    assert np.hypot(estimated.x_m - 8.0, estimated.y_m - 4.0) < 1.5


def test_fully_correlated_readings_count_as_one():
    quiet = tuple(replace(a, shadowing_db=1.0) for a in anchors_at(CORNERS + WALL_MIDDLES))
    model = level_model(quiet)
    window = window_at(model, (4.0, 5.5), np.random.default_rng(9), noise_db=1.0)
    white = solve(window, model).fix
    fixed = solve(window, model, params=replace(PARAMS, shadowing_correlation=1.0)).fix
    ratio = np.trace(matrix(fixed)) / np.trace(matrix(white))
    assert ratio == pytest.approx(28.0, rel=0.25)


def test_anchors_in_a_row_cover_both_sides():
    row = level_model(anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0), (15.0, 0.0))))
    rng = np.random.default_rng(10)
    for kinematic in (False, True):
        for place in ((6.0, 4.0), (6.0, -4.0), (6.0, 0.5)):
            result = solve(window_at(row, place, rng), row, kinematic=kinematic)
            assert not result.linearised
            error = np.array((result.fix.x_m - place[0], result.fix.y_m - place[1]))
            covariance = matrix(result.fix)
            assert error @ np.linalg.solve(covariance, error) < 9.21
            assert abs(result.fix.y_m) < 0.2
            assert np.sqrt(covariance[1, 1]) > 0.6 * abs(place[1])


def test_beside_a_row_a_walker_may_have_gone_on_since_the_middle_of_the_window():
    row = level_model(anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0), (15.0, 0.0))))
    window = window_at(row, (6.0, 4.0), np.random.default_rng(10))
    static = matrix(solve(window, row).fix)
    kinematic = matrix(solve(window, row, kinematic=True).fix)
    lag_s = 27 * 0.07 / 2
    np.testing.assert_allclose(kinematic - static, np.eye(2) * (1.3 * lag_s) ** 2 / 2, atol=1e-9)


def test_a_fix_wider_than_allowed_is_none():
    row = level_model(anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0))))
    window = window_at(row, (5.0, 6.0), np.random.default_rng(2))
    narrow = replace(PARAMS, max_sigma_m=3.0)
    result = estimate(window, row, NOW_S, kinematic=False, params=narrow)
    assert result == NoFix(NOW_S, NoFixReason.DEGENERATE_GEOMETRY)


def test_few_anchors_are_no_fix_unless_asked_for():
    model, rng = corners(), np.random.default_rng(2)
    window = window_at(model, (1.0, 1.5), rng)
    two = window_of(
        *(a[window.anchor_index < 2] for a in (window.anchor_index, window.time_s, window.rssi_dbm))
    )
    nothing = estimate(Window(), model, NOW_S, kinematic=False, params=PARAMS)
    assert nothing == NoFix(NOW_S, NoFixReason.NOTHING_HEARD)
    few = estimate(two, model, NOW_S, kinematic=False, params=PARAMS)
    assert few == NoFix(NOW_S, NoFixReason.TOO_FEW_TRANSMITTERS)
    near = solve(two, model, params=replace(PARAMS, min_anchors=1)).fix
    error = np.array((near.x_m - 1.0, near.y_m - 1.5))
    assert error @ np.linalg.solve(matrix(near), error) < 9.21
    assert near.used.beacons == 2


def test_one_epoch_has_no_velocity():
    model = corners()
    window = window_at(model, (4.0, 4.0), np.random.default_rng(2), epochs=1)
    result = solve(window, model, kinematic=True)
    assert result.fix.velocity_mps is None
    assert result.velocity_chi2 is None


def test_velocity_prior_narrows_the_current_position():
    model = corners()
    window = window_at(model, (5.0, 5.0), np.random.default_rng(12), velocity=(0.9, 0.0))
    free = solve(window, model, kinematic=True).fix
    bound = solve(window, model, kinematic=True, params=replace(PARAMS, velocity_prior_mps=1.0)).fix
    assert np.trace(matrix(bound)) < 0.8 * np.trace(matrix(free))


@pytest.mark.parametrize("place", [(0.05, 0.02), (5.0, 0.0)])
def test_phone_lying_on_an_anchor_is_found(place):
    model = corners_and_middles()
    result = solve(window_at(model, place, np.random.default_rng(13)), model)
    assert np.hypot(result.fix.x_m - place[0], result.fix.y_m - place[1]) < 0.8


def test_height_of_anchors_is_part_of_the_distance():
    anchors = tuple(replace(a, z_m=3.0) for a in anchors_at(((0, 0), (4, 0), (4, 4), (0, 4))))
    right = level_model(anchors, phone_height_m=1.0)
    flat = level_model(anchors, phone_height_m=3.0)
    window = window_at(right, (0.9, 0.6), np.random.default_rng(14), noise_db=0.5)
    found, wrong = solve(window, right).fix, solve(window, flat).fix
    assert np.hypot(found.x_m - 0.9, found.y_m - 0.6) < 0.2
    assert np.hypot(wrong.x_m - 0.9, wrong.y_m - 0.6) > 0.4


def test_told_where_phones_can_be_it_looks_nowhere_else() -> None:
    # Heard equally weakly, and only in a corner of the hall.
    window = window_of(np.array([0, 1, 2]), np.zeros(3), np.array([-75.0, -75.0, -75.0]))
    corner_m = np.array([(1.0, 1.0), (2.0, 2.0)])
    params = LaterationParams(search_margin_m=1.0)
    fixes = [
        estimate(window, corners(), 0.0, kinematic=False, params=params, area_m=area_m)
        for area_m in (None, corner_m)
    ]
    free, told = (found.fix for found in fixes if isinstance(found, Estimate))
    assert free.x_m > 4.0
    assert 0.0 <= told.x_m <= 3.0
    assert 0.0 <= told.y_m <= 3.0
