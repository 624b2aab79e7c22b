"""What zhu2018 published, on a few of the seeds of ``pharos evaluate papers``."""

import numpy as np
import pytest

from app.core.simulate.hall import straight_walk
from app.services.evaluation.figures import Figures
from app.services.evaluation.papers import PAPERS
from app.services.evaluation.papers.zhu2018 import reproduce
from app.services.evaluation.papers.zhu2018_rounds import (
    SEARCHED_S,
    Round,
    Tracks,
    backward_jump_m,
    walked_rounds,
    worst_corner,
)


@pytest.fixture(scope="module")
def figures() -> Figures:
    return reproduce(range(4))


@pytest.mark.parametrize("source", ["fingerprints", "pedometer"])
def test_the_mean_error_is_below_that_of_either_source(figures: Figures, source: str) -> None:
    errors = figures["mean_error_m"]
    assert errors["fused"]["median"] < errors[source]["median"]


@pytest.mark.parametrize("source", ["fingerprints", "pedometer"])
def test_the_worst_ends_are_below_those_of_either_source(figures: Figures, source: str) -> None:
    """The end is a single second: medians of a dozen rounds cannot tell 10 % apart, tails can."""
    errors = figures["end_error_m"]
    assert errors["fused"]["p90"] < errors[source]["p90"]


@pytest.mark.parametrize("name", ["backward_jump_m", "worst_corner_s", "worst_corner_m"])
def test_it_does_not_jump_back_and_turns_at_the_corners(figures: Figures, name: str) -> None:
    assert figures[name]["median"] <= figures[name]["target"]


def test_the_shares_are_of_all_rounds(figures: Figures) -> None:
    shares = {name: share["median"] for name, share in figures["share_of_rounds"].items()}
    assert shares["no_backward_jump"] >= 0.9
    assert shares["mean_below_both"] >= 0.6
    assert all(round(12 * share, 9).is_integer() for share in shares.values())


def test_it_is_one_of_the_papers() -> None:
    assert PAPERS["zhu2018"].reproduce is reproduce


def square(late_s: float, beside_m: float) -> tuple[Round, Tracks]:
    """A round of 20 m sides at 1 m/s, and a track of it that is late and beside it."""
    walk = next(walked_rounds(0))
    corners_m = np.array([(0, 0), (20, 0), (20, 20), (0, 20), (0, 0)], dtype=np.float64)
    truth = straight_walk(corners_m, 1.25)
    time_s = np.arange(1.0, 64.0)
    truth_m = truth.points_at(time_s)[:, :2]
    track_m = truth.points_at(time_s - late_s)[:, :2] + (beside_m, 0.0)
    round_ = Round(walk.world, corners_m, truth, ())
    return round_, Tracks(time_s, truth_m, track_m, truth_m, truth_m)


def test_a_perfect_track_turns_at_the_corners() -> None:
    late_s, off_m = worst_corner(*square(0.0, 0.0))
    assert late_s <= 1.0
    assert off_m <= 1.25


def test_a_late_track_turns_late_and_one_beside_turns_elsewhere() -> None:
    late_s, off_m = worst_corner(*square(5.0, 0.0))
    assert late_s == pytest.approx(5.0, abs=1.0)
    assert off_m <= 1.25
    late_s, off_m = worst_corner(*square(0.0, 4.0))
    assert late_s <= 1.0
    assert off_m == pytest.approx(4.0, abs=1.25)


def test_a_track_that_never_turns_has_missed_the_corner() -> None:
    walk, tracks = square(0.0, 0.0)
    straight_on = np.column_stack([tracks.time_s, np.zeros(len(tracks.time_s))])
    missed = Tracks(tracks.time_s, tracks.truth_m, straight_on, straight_on, straight_on)
    assert worst_corner(walk, missed)[0] == SEARCHED_S


def test_a_jump_back_is_measured_along_the_walk() -> None:
    _, tracks = square(0.0, 0.0)
    assert backward_jump_m(tracks) == 0.0
    tracks.fused_m[5:] -= (4.0, 0.0)
    assert backward_jump_m(tracks) == pytest.approx(4.0 - 1.25)
