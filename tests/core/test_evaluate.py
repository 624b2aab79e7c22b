"""The protocol of scores."""

import math

import pytest

from app.core.evaluate import Place, hold_last, score

HERE = Place("f1", 10.0, 20.0)
TRUTH = [(float(t), HERE) for t in range(4)]


def test_a_second_without_an_answer_holds_the_last_one_and_is_counted() -> None:
    answers = [Place("f1", 13.0, 24.0), None, Place("f2", 10.0, 20.0), None]
    seconds = hold_last(TRUTH, answers)
    assert [s.error_m for s in seconds] == [5.0, 5.0, 0.0, 0.0]
    result = score(seconds)
    assert result.samples == 4
    assert result.mean_error_m == 2.5
    assert result.floor_right_share == 0.5
    assert result.no_fix_share == 0.5


def test_before_the_first_answer_there_is_nothing_to_measure_only_to_count() -> None:
    result = score(hold_last(TRUTH, [None, None, HERE, HERE]))
    assert (result.samples, result.mean_error_m, result.no_fix_share) == (2, 0.0, 0.5)


def test_percentiles_are_over_all_seconds_pooled() -> None:
    walk = [(float(t), HERE) for t in range(101)]
    answers: list[Place | None] = [Place("f1", 10.0 + t, 20.0) for t in range(101)]
    result = score(hold_last(walk, answers))
    assert result.median_error_m == pytest.approx(50.0)
    assert result.p95_error_m == pytest.approx(95.0)


def test_a_wrong_floor_keeps_its_horizontal_error() -> None:
    result = score(hold_last(TRUTH[:1], [Place("f9", 10.0, 23.0)]))
    assert (result.mean_error_m, result.floor_right_share) == (3.0, 0.0)


def test_no_seconds_have_no_figures() -> None:
    result = score([])
    assert result.samples == 0
    assert math.isnan(result.mean_error_m)
    assert math.isnan(result.no_fix_share)
