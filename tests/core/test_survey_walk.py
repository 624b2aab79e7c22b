"""Between waypoints a surveyor is where the strides say, not where a straight line would be."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fusion.survey_walk import SurveyWalkParams, smoothed_walk, straight_walk
from app.core.types import FloatArray

PARAMS = SurveyWalkParams()
STRIDE_M, STRIDE_S, PAUSE_S = 0.7, 0.55, 20.0
CORNER, END = (14.0, 0.0), (14.0, 10.5)


def walked(seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return strides, the true times and places (n, 3) after each, and waypoints at both ends.

    East for 14 m, 20 s at rest at the corner, north for 10.5 m; every stride a little wrong.
    """
    rng = np.random.default_rng(seed)
    headings = [0.0] * 20 + [math.pi / 2.0] * 15
    time_s, place, strides, truth = 100.0, np.zeros(2), [], [(100.0, 0.0, 0.0)]
    for i, heading in enumerate(headings):
        time_s += STRIDE_S + (PAUSE_S if i == 20 else 0.0)
        place = place + STRIDE_M * np.array([math.cos(heading), math.sin(heading)])
        strides.append((time_s, STRIDE_M * rng.normal(1.0, 0.05), heading + rng.normal(0.0, 0.05)))
        truth.append((time_s, *place))
    ends = np.array([truth[0], truth[-1]])
    return np.array(strides), np.array(truth), ends


def errors_m(walk, truth: FloatArray) -> FloatArray:
    told = np.array([walk.at(time_s) for time_s in truth[:, 0]])
    return np.linalg.norm(told - truth[:, 1:], axis=1)


def test_strides_find_the_corner_and_the_pause_that_a_straight_line_misses() -> None:
    strides, truth, ends = walked()
    assert errors_m(smoothed_walk(strides, ends, PARAMS), truth).max() < 0.8
    assert errors_m(straight_walk(ends), truth).max() > 6.0


def test_a_surveyor_at_rest_stays_where_the_last_stride_ended() -> None:
    strides, _, ends = walked()
    walk = smoothed_walk(strides, ends, PARAMS)
    arrived_s = strides[19, 0]
    assert walk.at(arrived_s + PAUSE_S / 2.0) == pytest.approx(walk.at(arrived_s), abs=0.01)
    assert walk.at(arrived_s) == pytest.approx(CORNER, abs=0.8)


def test_the_walk_begins_and_ends_at_its_waypoints() -> None:
    strides, _, ends = walked()
    walk = smoothed_walk(strides, ends, PARAMS)
    assert walk.at(ends[0, 0] - 5.0) == pytest.approx((0.0, 0.0), abs=0.3)
    assert walk.at(ends[1, 0] + 5.0) == pytest.approx(END, abs=0.3)


@settings(max_examples=20, deadline=None)
@given(turn=st.floats(-math.pi, math.pi), scale=st.floats(0.5, 1.6))
def test_how_the_phone_is_held_and_how_long_steps_are_does_not_matter(
    turn: float, scale: float
) -> None:
    strides, truth, ends = walked()
    held = strides * np.array([1.0, scale, 1.0]) + np.array([0.0, 0.0, turn])
    expected = smoothed_walk(strides, ends, PARAMS)
    told = smoothed_walk(held, ends, PARAMS)
    for time_s in truth[:, 0]:
        assert told.at(time_s) == pytest.approx(expected.at(time_s), abs=1e-6)


@pytest.mark.parametrize(
    "strides", [np.empty((0, 3)), np.array([(101.0, 0.7, math.nan)] * 40)], ids=["none", "nan"]
)
def test_without_strides_it_is_the_straight_line(strides: FloatArray) -> None:
    ends = walked()[2]
    walk = smoothed_walk(strides, ends, PARAMS)
    assert walk.at(ends.mean(axis=0)[0]) == pytest.approx((7.0, 5.25))


def test_a_way_whose_strides_are_missing_is_straight_and_bends_no_other() -> None:
    strides, truth, _ = walked()
    corner_s = strides[19, 0] + PAUSE_S / 2.0
    waypoints = np.array([truth[0], (corner_s, *CORNER), truth[-1]])
    half = strides[strides[:, 0] > corner_s]
    walk = smoothed_walk(half, waypoints, PARAMS)
    middle_s = (truth[0, 0] + corner_s) / 2.0
    assert walk.at(middle_s) == pytest.approx((7.0, 0.0), abs=0.3)
    assert errors_m(walk, truth[21:]).max() < 0.8


def test_a_single_waypoint_is_where_everything_was() -> None:
    strides, truth, _ = walked()
    walk = smoothed_walk(strides, truth[:1], PARAMS)
    assert walk.at(truth[5, 0]) == (0.0, 0.0)
