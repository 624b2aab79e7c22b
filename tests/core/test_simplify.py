"""Simplification of a track."""

import numpy as np

from app.core.geometry import simplify_line


def test_a_straight_walk_keeps_its_ends_only() -> None:
    xy_m = np.column_stack((np.arange(50.0), np.full(50, 3.0)))
    assert np.flatnonzero(simplify_line(xy_m, 0.1)).tolist() == [0, 49]


def test_corners_stay_and_nothing_moves_further_than_the_tolerance() -> None:
    rng = np.random.default_rng(1)
    corner = np.vstack(
        (
            np.column_stack((np.arange(20.0), np.zeros(20))),
            np.column_stack((np.full(20, 19.0), np.arange(1.0, 21.0))),
        )
    )
    xy_m = corner + rng.normal(0, 0.05, corner.shape)
    keep = simplify_line(xy_m, 0.3)
    assert keep.sum() == 3
    assert keep[19]


def test_standing_still_keeps_two_points() -> None:
    assert simplify_line(np.ones((10, 2)), 0.5).sum() == 2
    assert simplify_line(np.ones((1, 2)), 0.5).tolist() == [True]
