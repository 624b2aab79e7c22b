"""The weighted centroid, beyond the laws that every estimator keeps."""

import numpy as np
import pytest
from lateration_room import CORNERS, anchors_at

from app.core.lateration.centroid import CentroidParams, weighted_centroid
from app.core.radio.path_loss import level_model
from app.core.radio.windows import window_of
from app.core.types import Fix


def centroid(levels_dbm, places=CORNERS, **params) -> Fix:
    window = window_of(np.arange(len(levels_dbm)), np.zeros(len(levels_dbm)), np.array(levels_dbm))
    found = weighted_centroid(
        window, level_model(anchors_at(places)), 0.0, CentroidParams(**params)
    )
    assert isinstance(found, Fix)
    return found


def test_equal_levels_are_the_middle_and_ten_decibels_weigh_ten_times() -> None:
    fix = centroid([-60.0, -60.0, -60.0, -60.0])
    assert (fix.x_m, fix.y_m) == pytest.approx((5.0, 5.0))
    fix = centroid([-60.0, -60.0, -70.0, -70.0])
    # (1 + 1) at y = 0 against (0.1 + 0.1) at y = 10.
    assert (fix.x_m, fix.y_m) == pytest.approx((5.0, 10.0 / 11.0))


def test_only_the_strongest_count() -> None:
    far = ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0), (500.0, 500.0))
    assert centroid([-60.0, -60.0, -60.0, -61.0], far, strongest=3).x_m == pytest.approx(10.0 / 3.0)
