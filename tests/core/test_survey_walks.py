import math

import numpy as np
import pytest

from app.core.motion.walks import LEAD_S, strides_of, survey_walks
from app.core.params import StepParams
from app.core.types import Pedometer, Reading, Steps, Truth, WifiScan

SCANS = [WifiScan(float(t), (Reading(("mac:0",), -50.0),)) for t in range(0, 100, 5)]


def test_a_change_of_floor_ends_a_walk_and_scans_between_belong_to_neither():
    truths = [
        Truth(20.0, 0.0, 0.0, "ground"),
        Truth(40.0, 9.0, 0.0, "ground"),
        Truth(60.0, 9.0, 1.0, "upper"),
        Truth(80.0, 0.0, 1.0, "upper"),
    ]
    first, second = survey_walks("w", [*SCANS, *truths])
    assert [(w.walk, w.floor_id) for w in (first, second)] == [("w", "ground"), ("w/2", "upper")]
    assert first.scans[0].time_s == 20.0 - LEAD_S
    assert first.scans[-1].time_s == 50.0
    assert second.scans[0].time_s == 50.0
    assert second.waypoints.tolist() == [[60.0, 9.0, 1.0], [80.0, 0.0, 1.0]]


def test_a_quick_change_of_floor_lets_no_scan_cross_the_other_floors_waypoint():
    truths = [Truth(40.0, 9.0, 0.0, "ground"), Truth(44.0, 9.0, 1.0, "upper")]
    first, second = survey_walks("w", [*SCANS, *truths])
    assert max(scan.time_s for scan in first.scans) <= 44.0
    assert min(scan.time_s for scan in second.scans) >= 40.0


def test_a_recording_without_truths_is_no_walk():
    assert survey_walks("w", SCANS) == []


def test_steps_that_the_phone_tells_are_strides_with_its_heading():
    told = [Steps(10.0, 2, 0.6, math.pi / 2), Steps(12.0, 1, None, None)]
    strides = strides_of(told, StepParams())
    seconds = 1.0 / StepParams().cadence_hz
    assert strides[:, 0] == pytest.approx([10.0 - seconds, 10.0, 12.0])
    assert strides[:, 1] == pytest.approx([0.6, 0.6, StepParams().usual_length_m])
    assert strides[:2, 2].tolist() == [math.pi / 2] * 2
    assert np.isnan(strides[2, 2])


def test_a_pedometers_steps_are_spread_over_its_time_and_distance():
    strides = strides_of([Pedometer(10.0, 14.0, 4, 3.0)], StepParams())
    assert strides[:, 0].tolist() == [11.0, 12.0, 13.0, 14.0]
    assert strides[:, 1].tolist() == [0.75] * 4
