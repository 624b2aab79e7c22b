"""The protocol of scores."""

import math

import pytest

from app.core.evaluate import Answer, Place, hold_last, recorded_seconds, score
from app.core.types import Barometer, BleScan

HERE = Place("f1", 10.0, 20.0)
THERE = Answer("f1", 10.0, 20.0, 1.0)
TRUTH = [(float(t), HERE) for t in range(4)]


def test_a_second_without_an_answer_holds_the_last_one_and_is_counted() -> None:
    answers = [Answer("f1", 13.0, 24.0, 6.0), None, Answer("f2", 10.0, 20.0, 6.0), None]
    seconds = hold_last(TRUTH, answers)
    assert [s.error_m for s in seconds] == [5.0, 5.0, 0.0, 0.0]
    result = score(seconds)
    assert result.samples == 4
    assert result.mean_error_m == 2.5
    assert result.floor_right_share == 0.5
    assert result.no_fix_share == 0.5
    assert result.lost_share == 0.5


def test_before_the_first_answer_there_is_nothing_to_measure_only_to_count() -> None:
    result = score(hold_last(TRUTH, [None, None, THERE, THERE]))
    assert (result.samples, result.mean_error_m, result.no_fix_share) == (2, 0.0, 0.5)
    assert result.lost_share == 0.0


def test_percentiles_are_over_all_seconds_pooled() -> None:
    walk = [(float(t), HERE) for t in range(101)]
    answers = [Answer("f1", 10.0 + t, 20.0, 1.0) for t in range(101)]
    result = score(hold_last(walk, answers))
    assert result.median_error_m == pytest.approx(50.0)
    assert result.p75_error_m == pytest.approx(75.0)
    assert result.p95_error_m == pytest.approx(95.0)


def test_a_wrong_floor_keeps_its_horizontal_error() -> None:
    result = score(hold_last(TRUTH[:1], [Answer("f9", 10.0, 23.0, 1.0)]))
    assert (result.mean_error_m, result.floor_right_share) == (3.0, 0.0)


def test_no_seconds_have_no_figures() -> None:
    result = score([])
    assert result.samples == 0
    assert math.isnan(result.mean_error_m)
    assert math.isnan(result.no_fix_share)


def test_coverage_counts_the_truth_inside_the_radius_told_and_nothing_that_is_held() -> None:
    answers = [Answer("f1", 13.0, 24.0, 5.0), Answer("f1", 13.0, 24.0, 4.9), None, None]
    result = score(hold_last(TRUTH, answers))
    assert result.coverage95_share == 0.5
    assert result.mean_radius95_m == pytest.approx(4.95)


def test_deciles_of_coverage_go_by_the_size_of_the_radius() -> None:
    walk = [(float(t), HERE) for t in range(20)]
    # Ten metres off throughout: only the larger half of the radii reaches the truth.
    answers = [Answer("f1", 20.0, 20.0, 20.0 - t) for t in range(20)]
    assert score(hold_last(walk, answers)).coverage95_share_by_decile == (
        *(0.0, 0.0, 0.0, 0.0, 0.5),
        *(1.0, 1.0, 1.0, 1.0, 1.0),
    )


def test_a_recording_is_cut_at_whole_seconds_and_counts_from_its_first_scan_on() -> None:
    before, scan, after = Barometer(7.9, 1000.0), BleScan(8.2, ()), Barometer(10.0, 1000.0)
    seconds = list(recorded_seconds([after, before, scan]))
    assert [(s.end_s, s.observations, s.is_scored) for s in seconds] == [
        (8, (before,), False),
        (9, (scan,), True),
        (10, (), True),
        (11, (after,), True),
    ]
    assert not list(recorded_seconds([]))
