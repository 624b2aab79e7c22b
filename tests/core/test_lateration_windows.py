"""Level model and window: the values that lateration starts from."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lateration_room import anchors_at, corners_and_middles

from app.core.radio.path_loss import (
    NEAR_FIELD_M,
    distances_of_levels,
    expected_levels,
    level_gradients,
    level_model,
)
from app.core.radio.windows import Window, joined, of_anchors, window_of, window_of_scan, within
from app.core.types import Reading


def arrays(window: Window) -> list[list[float]]:
    return [window.anchor_index.tolist(), window.time_s.tolist(), window.rssi_dbm.tolist()]


def test_level_at_the_calibration_distance_is_the_calibration_level():
    anchor = replace(anchors_at(((0.0, 0.0),))[0], ref_level_dbm=-63.0, ref_distance_m=2.0)
    model = level_model((anchor,))
    assert expected_levels(model, np.array([2.0]), np.array([0.0]))[0, 0] == pytest.approx(-63.0)
    tenfold = expected_levels(model, np.array([20.0]), np.array([0.0]))[0, 0]
    assert tenfold == pytest.approx(-63.0 - 10 * anchor.path_loss_exponent)


def test_calibration_distance_does_not_change_the_derivative():
    near = anchors_at(((0.0, 0.0),))[0]
    far = replace(near, ref_distance_m=3.0)
    place = np.array([2.0]), np.array([1.0])
    np.testing.assert_array_equal(
        level_gradients(level_model((near,)), *place), level_gradients(level_model((far,)), *place)
    )


@settings(max_examples=40, deadline=None)
@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(0, 4))
def test_derivative_and_inverse_belong_to_the_model(x, y, height):
    model = level_model(
        tuple(replace(a, z_m=height) for a in anchors_at(((0.1, 0.2), (5.0, 5.0)), 2.2))
    )
    place, step = (np.array([x]), np.array([y])), 1e-5
    levels = expected_levels(model, *place)
    distance = np.hypot(np.hypot(x - model.table[:, 0], y - model.table[:, 1]), height)
    bounded = np.maximum(distance, NEAR_FIELD_M)
    np.testing.assert_allclose(distances_of_levels(model, levels)[0], bounded, rtol=1e-9)
    slope = (expected_levels(model, place[0] + step, place[1]) - levels) / step
    far = distance > NEAR_FIELD_M + 0.01
    gradient = level_gradients(model, *place)[0, :, 0]
    np.testing.assert_allclose(gradient[far], slope[0, far], rtol=1e-2, atol=1e-3)
    assert np.isfinite(gradient).all()


def test_window_is_the_same_however_readings_arrive():
    rng = np.random.default_rng(1)
    anchor, time_s = rng.integers(0, 4, 50), 100.0 + rng.integers(0, 9, 50) * 0.25
    level = rng.integers(-90, -50, 50).astype(float)
    whole = window_of(anchor, time_s, level)
    order = rng.permutation(50)
    parts = Window()
    for part in np.array_split(order, 7):
        parts = joined(parts, window_of(anchor[part], time_s[part], level[part]))
    assert arrays(parts) == arrays(whole)
    assert arrays(joined(whole, whole)) == arrays(whole)


def test_window_drops_what_is_old_and_what_is_not_wanted():
    window = window_of(np.array([0, 1, 1, 2]), np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, -60.0))
    assert within(window, 1.0, 3.0).time_s.tolist() == [2.0, 3.0]
    assert of_anchors(window, np.array([True, False, True])).anchor_index.tolist() == [0, 2]
    assert window.anchors_heard == 3
    assert Window().anchors_heard == 0


def test_scan_gives_readings_of_known_anchors_at_their_own_times():
    readings = (
        Reading(("mac:0a", "ibeacon:u:1:1"), -60.0, age_s=0.5),
        Reading(("ibeacon:u:1:1",), -60.0, age_s=0.5),
        Reading(("mac:ff", "ibeacon:u:1:2"), -70.0),
        Reading(("mac:unknown",), -50.0),
    )
    window = window_of_scan(readings, 10.0, {"ibeacon:u:1:1": 3, "mac:ff": 0, "ibeacon:u:1:2": 1})
    assert arrays(window) == [[0, 3], [10.0, 9.5], [-70.0, -60.0]]
    assert len(window_of_scan((), 10.0, {})) == 0


def test_window_survives_serialisation():
    window = window_of(np.array([1, 0]), np.array([2.0, 1.0]), np.array([-60.0, -61.0]))
    assert arrays(pickle.loads(pickle.dumps(window))) == arrays(window)


def test_many_places_at_once_are_the_places_one_by_one():
    model, rng = corners_and_middles(), np.random.default_rng(3)
    x, y = rng.uniform(0, 10, 5), rng.uniform(0, 10, 5)
    single = [expected_levels(model, x[i : i + 1], y[i : i + 1])[0] for i in range(5)]
    np.testing.assert_array_equal(expected_levels(model, x, y), single)
