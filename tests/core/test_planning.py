"""The planner's predictions: the published table, simulated windows, walls, beacons left out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lateration_room import (
    CORNERS,
    EPOCHS,
    PERIOD_S,
    WALL_MIDDLES,
    anchors_at,
    corners,
    corners_and_middles,
)

from app.core.geometry import Walkable
from app.core.lateration.gauss_newton import minimise
from app.core.lateration.planning import (
    FixRule,
    Ground,
    Prediction,
    information,
    leave_one_out_m2,
    predict,
    traces,
)
from app.core.lateration.predicted import Schedule, cell_centres, predicted_sigma_m
from app.core.radio import walls
from app.core.radio.path_loss import SIGMA, LevelModel, X, Y, expected_levels, level_model
from app.core.radio.walls import HearingParams, TooManyWallsError, crosses, heard

HEARING = HearingParams()
STATIC = FixRule(Schedule().position_factor(kinematic=False))
LEAST_SQUARES = (1e6, 0.0, 0.0)
"""No robust weights and no priors: the published method, which D is the covariance of."""


def room(width_m=10.0, height_m=10.0, cell_m=0.5, walls=()) -> Ground:
    x_m, y_m = cell_centres(width_m, height_m, cell_m)
    return Ground(x_m.ravel(), y_m.ravel(), np.array(walls, dtype=np.float64).reshape(-1, 5))


def of(prediction: Prediction, kinematic: bool) -> np.ndarray:
    return prediction.kinematic_m if kinematic else prediction.static_m


@pytest.mark.parametrize(
    ("layout", "kinematic", "low", "median", "high"),
    [
        (corners, False, 0.94, 1.05, 1.29),
        (corners, True, 1.83, 2.05, 2.52),
        (corners_and_middles, False, 0.44, 0.51, 0.64),
        (corners_and_middles, True, 0.85, 1.00, 1.24),
    ],
)
def test_the_planner_gives_the_published_table(layout, kinematic, low, median, high) -> None:
    sigma_m = of(predict(room(), layout(), Schedule(), HEARING), kinematic)
    found = (sigma_m.min(), np.median(sigma_m), sigma_m.max())
    assert found == pytest.approx((low, median, high), abs=0.0051)


def simulated_rms_m(model: LevelModel, place: np.ndarray, kinematic: bool, rng) -> float:
    """Return the root mean square error of forty windows of a phone at rest in a place."""
    windows, n = 40, model.anchors
    tau_s = (np.arange(EPOCHS) - (EPOCHS - 1)) * PERIOD_S
    level_dbm = np.tile(expected_levels(model, place[:1], place[1:])[0], EPOCHS)
    anchor, time_s = np.tile(np.arange(n), EPOCHS), np.repeat(tau_s, n)
    precision = 1.0 / model.table[anchor, SIGMA]
    start = np.array([*place, 0.0, 0.0] if kinematic else place)
    errors_m = np.empty((windows, 2))
    for error_m in errors_m:
        noisy_dbm = level_dbm + rng.normal(0.0, 5.0, len(level_dbm))
        rows = (anchor, time_s, noisy_dbm, precision)
        error_m[:] = minimise(rows, model.table, start, LEAST_SQUARES)[0][:2] - place
    return float(np.sqrt((errors_m**2).sum(axis=1).mean()))


@pytest.mark.parametrize("kinematic", [False, True])
@pytest.mark.parametrize("layout", [corners, corners_and_middles])
def test_simulated_windows_scatter_as_the_map_says(layout, kinematic) -> None:
    ground, model, rng = room(), layout(), np.random.default_rng(2018)
    sigma_m = of(predict(ground, model, Schedule(), HEARING), kinematic)
    places = np.column_stack((ground.x_m, ground.y_m))
    to_beacon_m = np.linalg.norm(places[:, None] - model.table[None, :, X : Y + 1], axis=2)
    far = to_beacon_m.min(axis=1) >= 1.0
    ratio = np.array(
        [
            simulated_rms_m(model, place, kinematic, rng) / predicted_m
            for place, predicted_m in zip(places[far], sigma_m[far], strict=True)
        ]
    )
    assert len(ratio) > 300
    assert 0.9 <= np.median(ratio) <= 1.1
    assert np.mean(np.abs(ratio - 1.0) <= 0.35) >= 0.9


def test_the_planner_agrees_with_the_closed_form_of_the_whole_matrix() -> None:
    rng = np.random.default_rng(3)
    model = level_model(anchors_at(rng.uniform(0.0, 40.0, (12, 2)), exponent=2.2))
    ground, schedule = room(40.0, 30.0, 1.0), Schedule(epochs=9, period_s=0.2, at_s=0.5)
    found = predict(ground, model, schedule, HearingParams(reach_m=15.0))
    for kinematic in (False, True):
        expected_m = predicted_sigma_m(
            model, ground.x_m, ground.y_m, schedule, kinematic=kinematic, reach_m=15.0
        )
        expected_m[found.in_range < 3] = np.inf
        np.testing.assert_allclose(of(found, kinematic), expected_m, rtol=1e-6)
        assert 0 < np.isinf(expected_m).sum() < len(expected_m)
    distance_m = np.hypot(
        ground.x_m[:, None] - model.table[:, X], ground.y_m[:, None] - model.table[:, Y]
    )
    np.testing.assert_array_equal(found.in_range, (distance_m <= 15.0).sum(axis=1))


def test_a_level_under_the_threshold_is_not_heard() -> None:
    model = level_model(anchors_at(((0.0, 0.0),), exponent=2.0))
    x_m = np.array([9.9, 10.1])
    at_ten_metres = HearingParams(threshold_dbm=-59.0 - 20.0)
    none = np.empty((0, 5))
    assert heard(model, x_m, np.zeros(2), none, at_ten_metres).tolist() == [[True, False]]


def test_walls_silence_what_lies_behind_them() -> None:
    """At 5 m a beacon of -59 dBm has 10 dB over the threshold: two walls of 6 dB are too much."""
    model = level_model(anchors_at(((0.0, 0.0),), exponent=2.0))
    threshold = HearingParams(threshold_dbm=-59.0 - 20.0 * np.log10(5.0) - 10.0)
    places = np.array([(5.0, 0.0), (-5.0, 0.0), (3.0, 4.0)])
    near, far, short = (1.0, -1.0, 1.0, 1.0, 6.0), (4.0, -1.0, 4.0, 1.0, 6.0), (4.0, 1.0, 4.0, 3.0)

    def ask(*walls) -> list[bool]:
        rows = np.array(walls, dtype=np.float64).reshape(-1, 5)
        return heard(model, places[:, 0], places[:, 1], rows, threshold)[0].tolist()

    assert ask() == [True, True, True]
    assert ask(near) == [True, True, True]
    assert ask(near, far) == [False, True, True]
    assert ask(near, (*short, 60.0)) == [True, True, True]
    assert ask((0.0, -1.0, 0.0, 1.0, 60.0)) == [True, True, True], "an anchor in a wall"


def test_behind_a_wall_the_fix_is_lost_and_the_rest_stays_as_it_was() -> None:
    wall = (5.0, -1.0, 5.0, 11.0, 60.0)
    places = ((1.0, 1.0), (1.0, 9.0), (4.0, 5.0))
    model = level_model(anchors_at(places))
    open_room = predict(room(), model, Schedule(), HEARING)
    divided = predict(room(walls=[wall]), model, Schedule(), HEARING)
    left = room().x_m < 5.0
    np.testing.assert_array_equal(divided.static_m[left], open_room.static_m[left])
    assert np.isinf(divided.static_m[~left]).all()
    assert np.isinf(divided.kinematic_m[~left]).all()
    assert divided.in_range[left].tolist() == [3] * int(left.sum())
    assert not divided.in_range[~left].any()


@given(
    st.lists(st.tuples(*[st.floats(-10, 20, width=32)] * 4), max_size=30),
    st.tuples(st.floats(-2, 12, width=32), st.floats(-2, 12, width=32)),
)
def test_no_wall_is_missed_in_any_direction(ends, place) -> None:
    """Against testing every line with every wall."""
    ground = room(cell_m=2.0, walls=[(*wall, 60.0) for wall in ends])
    model = level_model(anchors_at([place], exponent=2.0))
    threshold = HearingParams(threshold_dbm=-94.0)
    found = heard(model, ground.x_m, ground.y_m, ground.walls, threshold)[0]
    free = [
        not any(crosses(x_m, y_m, *place, wall) for wall in ground.walls)
        for x_m, y_m in zip(ground.x_m, ground.y_m, strict=True)
    ]
    assert found.tolist() == free


def test_too_many_walls_are_refused_and_not_waited_for(monkeypatch) -> None:
    ground = room(walls=[(5.0, 0.0, 5.0, 10.0, 0.0)])
    places = (ground.x_m, ground.y_m, ground.walls)
    model = level_model(anchors_at(CORNERS))
    monkeypatch.setattr(walls, "MAX_CROSSING_TESTS", 1000)
    at_once = HearingParams(reach_m=4.0)
    assert heard(model, *places, at_once).any()
    with pytest.raises(TooManyWallsError):
        heard(level_model(anchors_at(CORNERS * 50)), *places, HEARING)


@given(
    st.lists(st.tuples(st.floats(0, 10), st.floats(0, 10)), min_size=1, max_size=8),
    st.tuples(st.floats(0, 10), st.floats(0, 10)),
)
def test_one_more_beacon_never_makes_it_worse(places, one_more) -> None:
    ground = room(cell_m=1.0)
    fewer = predict(ground, level_model(anchors_at(places)), Schedule(), HEARING)
    more = predict(ground, level_model(anchors_at([*places, one_more])), Schedule(), HEARING)
    assert (more.static_m <= fewer.static_m * (1.0 + 1e-6)).all()
    assert (more.in_range == fewer.in_range + 1).all()


def test_leaving_one_out_is_planning_without_it() -> None:
    anchors = anchors_at((*CORNERS, *WALL_MIDDLES, (0.3, 0.2)))
    ground = room()
    hearing = HearingParams(reach_m=9.0)
    model = level_model(anchors)
    audible = heard(model, ground.x_m, ground.y_m, ground.walls, hearing)
    found_m2 = leave_one_out_m2(model, ground, audible, STATIC)
    assert found_m2.shape == (9, 400)
    for i in range(len(anchors)):
        rest = level_model(anchors[:i] + anchors[i + 1 :])
        expected_m = predict(ground, rest, Schedule(), hearing).static_m
        np.testing.assert_allclose(np.sqrt(found_m2[i]), expected_m, rtol=1e-6)


def both_traces(model: LevelModel, rule: FixRule) -> tuple[np.ndarray, np.ndarray]:
    """Return trace D in the room without the prior and with it, in priors."""
    ground = room()
    audible = heard(model, ground.x_m, ground.y_m, ground.walls, HEARING)
    epoch = information(model, ground, audible)
    return traces(epoch, rule, 0.0), traces(epoch, rule, ground.prior_m2) / ground.prior_m2


def test_two_beacons_are_no_fix_unless_asked_for() -> None:
    two = level_model(anchors_at(CORNERS[:2]))
    assert np.isinf(both_traces(two, STATIC)[0]).all()
    mirrored = FixRule(STATIC.covariance_scale, min_anchors=2)
    assert np.isfinite(both_traces(two, mirrored)[0]).all()


def test_the_prior_costs_what_a_fix_lacks_and_nothing_else() -> None:
    open_m2, bounded = both_traces(corners(), STATIC)
    np.testing.assert_allclose(bounded * room().prior_m2, open_m2, rtol=1e-4)
    # One open direction and two lacking anchors; both directions and three anchors.
    one = level_model(anchors_at(((2.0, 2.0),)))
    np.testing.assert_allclose(both_traces(one, STATIC)[1], 3.0, rtol=0.01)
    np.testing.assert_allclose(both_traces(level_model(()), STATIC)[1], 5.0)


def test_distances_to_walkable_floor_are_those_of_single_places() -> None:
    rng = np.random.default_rng(1)
    walkable = Walkable(-1.0, 2.0, 0.5, rng.uniform(0.0, 5.0, (6, 9)))
    x_m, y_m = rng.uniform(-5.0, 10.0, 50), rng.uniform(-5.0, 10.0, 50)
    singly = [walkable.distance_at(x, y) for x, y in zip(x_m, y_m, strict=True)]
    assert walkable.distances_at(x_m, y_m).tolist() == singly
