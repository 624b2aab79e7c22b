"""Line of sight: lost level and lively fading hide a beacon; rooms fall back to fingerprints."""

import numpy as np
import pytest

from app.core.radio.line_of_sight import Believed, LineOfSightParams, lines_of_sight
from app.core.radio.path_loss import expected_levels, level_model
from app.core.radio.windows import Window, window_of
from app.core.types import Anchor

PARAMS = LineOfSightParams()
MODEL = level_model(
    [Anchor(f"a{i}", (f"k{i}",), "f", 4.0 * i, 2.0, shadowing_db=3.0) for i in range(3)]
)
PLACE = np.array([4.0, -1.0])


def window_with(level_dbm, fading_db, rng, readings=15):
    """Return a window of all beacons: mean levels (3,), and levels' deviation in time (3,)."""
    anchor = np.repeat(np.arange(3), readings)
    time_s = np.tile(np.arange(readings) / 10.0, 3)
    level = np.asarray(level_dbm)[anchor] + np.asarray(fading_db)[anchor] * rng.normal(
        size=len(anchor)
    )
    return window_of(anchor, time_s, level)


def expected():
    return expected_levels(MODEL, PLACE[:1], PLACE[1:])[0]


def believed(sigma_m):
    return Believed(PLACE, sigma_m**2 * np.eye(2))


def share_in_sight(loss_db, fading_db, belief, params=PARAMS, seeds=60):
    seen = [
        lines_of_sight(
            window_with(expected() - loss_db, np.full(3, fading_db), np.random.default_rng(s)),
            MODEL,
            belief,
            params,
        ).in_sight
        for s in range(seeds)
    ]
    return np.mean(seen)


def test_deviation_alone_tells_what_is_hidden_where_the_track_is_known():
    alike = LineOfSightParams(seen_fading_db=3.5, hidden_fading_db=3.5)
    assert share_in_sight(0.0, 3.5, believed(0.5), alike) > 0.95
    assert share_in_sight(12.0, 3.5, believed(0.5), alike) < 0.05
    assert share_in_sight(12.0, 3.5, None, alike) == 1.0
    # Nothing between phone and beacon makes a level louder.
    assert share_in_sight(-8.0, 3.5, believed(0.5), alike) > 0.9


def test_fading_alone_tells_what_is_hidden_without_a_track():
    assert share_in_sight(0.0, 2.5, None) > 0.95
    assert share_in_sight(0.0, 5.57, None) < 0.1


def test_a_doubtful_track_lets_the_fading_decide():
    assert share_in_sight(12.0, 2.5, believed(30.0)) > 0.9
    assert share_in_sight(12.0, 2.5, believed(0.3)) < share_in_sight(12.0, 2.5, believed(30.0))


def test_each_beacon_is_judged_on_its_own():
    rng = np.random.default_rng(4)
    window = window_with(expected() - [0.0, 15.0, 0.0], [2.5, 5.57, 2.5], rng)
    sights = lines_of_sight(window, MODEL, believed(0.5), PARAMS)
    assert sights.in_sight.tolist() == [True, False, True]
    assert sights.laterate


def test_quiet_beacons_are_out_of_range_and_a_window_without_any_is_for_fingerprints():
    rng = np.random.default_rng(5)
    quiet = lines_of_sight(window_with([-95.0, -60.0, -95.0], [2.0] * 3, rng), MODEL, None, PARAMS)
    assert quiet.anchor_index.tolist() == [1]
    hidden = lines_of_sight(window_with([-95.0] * 3, [2.0] * 3, rng), MODEL, None, PARAMS)
    for none in (hidden, lines_of_sight(Window(), MODEL, None, PARAMS)):
        assert len(none.anchor_index) == 0
        assert not none.laterate


def test_one_reading_without_a_track_keeps_the_prior():
    once = window_of(np.array([1]), np.array([0.0]), np.array([-60.0]))
    sights = lines_of_sight(once, MODEL, None, LineOfSightParams(prior_probability=0.7))
    assert sights.probability == pytest.approx([0.7])
    assert sights.level_dbm == pytest.approx([-60.0])


def test_more_readings_than_are_independent_make_no_surer():
    rng = np.random.default_rng(6)
    level = rng.normal(-60.0, 5.0, 10)

    def heard(copies):
        levels = np.tile(level, copies)
        window = window_of(np.zeros(len(levels), int), np.arange(len(levels)) / 10.0, levels)
        return lines_of_sight(window, MODEL, None, PARAMS).probability[0]

    # Ten times as many readings of the same spread: but for n - 1 against n nothing changes.
    assert heard(10) == pytest.approx(heard(1), abs=0.05)
