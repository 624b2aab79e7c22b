"""The figures of placing by strides, on a walk that is known."""

import numpy as np

from app.core.survey import SurveyWalk
from app.services.evaluation.survey_walks import left_out_errors
from app.services.radio_map_building import Placing


def test_a_waypoint_left_out_at_a_corner_is_found_by_strides_and_missed_by_the_line() -> None:
    headings = np.repeat([0.0, np.pi / 2.0], 20)
    time_s = np.arange(1.0, 41.0)
    strides = np.column_stack([time_s, np.full(40, 0.7), headings])
    waypoints = np.array([(0.0, 0.0, 0.0), (20.0, 14.0, 0.0), (40.0, 14.0, 14.0)])
    walk = SurveyWalk("w", "f", (), strides, waypoints)
    (smoothed,) = left_out_errors([walk], Placing.SMOOTHED)
    (straight,) = left_out_errors([walk], Placing.STRAIGHT)
    assert smoothed < 0.1
    assert 9.0 < straight < 10.0
