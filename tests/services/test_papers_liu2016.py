"""What Liu et al. 2016 report, reproduced on a few seeds."""

import numpy as np
import pytest

from app.services.evaluation.papers.liu2016 import reproduce
from app.services.evaluation.papers.liu2016_corridor import (
    ROUND,
    WIFI_MEAN_ERROR_M,
    SetUp,
    corridor_walk,
)


@pytest.fixture(scope="module")
def figures():
    return reproduce(range(20))


def test_the_ratios_of_the_paper_come_out(figures):
    for name in ("blended_ratio", "filtered_ratio"):
        assert figures[name]["median"] <= figures[name]["target"]
    assert figures["filtered_ratio"]["target"] == 0.60
    assert figures["filtered_mean_error_m"]["median"] < figures["blended_mean_error_m"]["median"]


def test_what_is_simulated_errs_as_the_papers_sensors_did(figures):
    for name in ("wifi_mean_error_m", "double_integration_mean_error_m"):
        assert figures[name]["median"] == pytest.approx(figures[name]["target"], rel=0.2)


def test_many_more_points_are_within_3_m(figures):
    assert figures["points_more_within_3_m"]["median"] >= 26.0


def test_planted_weights_come_back(figures):
    assert figures["planted_weights_worst_error"]["p90"] < 0.1


def test_fitted_weights_are_no_worse_than_the_published_ones(figures):
    fitted = figures["fitted"]
    for name in ("blended_ratio", "filtered_ratio"):
        assert fitted[name]["median"] <= figures[name]["median"] + 0.02


def test_the_ratio_does_not_hold_where_fixes_err_alike(figures):
    alike = figures["other_set_ups"]["fixes_err_alike_over_2_m"]
    assert alike["blended_ratio"]["median"] > 0.68
    assert alike["filtered_ratio"]["median"] > 0.60


def test_the_walk_is_the_one_described():
    walks = [corridor_walk(np.random.default_rng(seed), SetUp()) for seed in range(30)]
    errors_m = [
        np.hypot(fix.x_m - place[0], fix.y_m - place[1])
        for walk in walks
        for fix, place in zip(walk.fixes[1:], walk.places[1:], strict=True)
    ]
    assert np.mean(errors_m) == pytest.approx(WIFI_MEAN_ERROR_M, rel=0.05)
    for walk in walks:
        assert walk.places[0] == pytest.approx([0.0, 0.0])
        assert walk.places[-1, 0] == pytest.approx(40.0, abs=1.5)
        assert len(walk.sensed) == len(walk.fixes) - 1


def test_the_calibration_walk_turns_and_stops():
    walk = corridor_walk(np.random.default_rng(0), SetUp(ROUND))
    steps = np.diff(walk.places, axis=0)
    moving = steps[np.hypot(*steps.T) > 0.5]
    assert len(np.unique(np.round(np.arctan2(*moving.T), 1))) >= 4
    assert np.count_nonzero(np.hypot(*steps.T) < 1e-9) >= 8
