"""The range filter: steps carry it, ranges correct it, and far ranges count less."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fusion.planar import PlanarTrack
from app.core.fusion.range_ekf import (
    RangeEkfParams,
    Ranges,
    carried,
    corrected,
    pulled,
    range_sigma_m,
)
from app.core.radio.path_loss import SLOPE, distances_of_levels, expected_levels, level_model
from app.core.types import Anchor

PARAMS = RangeEkfParams()
CORNERS = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 15.0], [0.0, 15.0]])


def ranges_from(place, sigma_m=1.0, dz2_m2=0.0):
    distance = np.sqrt(((CORNERS - place) ** 2).sum(axis=1) + dz2_m2)
    count = len(CORNERS)
    return Ranges(CORNERS, np.full(count, dz2_m2), distance, np.full(count, sigma_m))


def track(x, y, variance_m2=9.0):
    return PlanarTrack(np.array([x, y]), variance_m2 * np.eye(2))


def test_a_step_moves_the_track_and_widens_it_across_more_than_along():
    after = carried(track(1.0, 2.0, 1.0), 0.7, math.pi / 2, RangeEkfParams(along_share=0.1))
    assert after.mean == pytest.approx([1.0, 2.7])
    assert after.covariance == pytest.approx(np.diag([1.0 + (0.7 * 0.14) ** 2, 1.0 + 0.07**2]))


def test_a_step_of_unknown_heading_widens_the_track_where_it_is():
    after = carried(track(1.0, 2.0, 1.0), 0.7, math.nan, PARAMS)
    assert after.mean == pytest.approx([1.0, 2.0])
    assert after.covariance == pytest.approx(np.eye(2) * (1.0 + 0.245))


@pytest.mark.parametrize("dz2_m2", [0.0, 4.0])
def test_exact_ranges_draw_the_track_to_the_place(dz2_m2):
    place = np.array([7.0, 6.0])
    found = track(10.0, 9.0, 100.0)
    for _ in range(5):
        found = corrected(found, ranges_from(place, dz2_m2=dz2_m2))
    assert found.mean == pytest.approx(place, abs=0.05)
    assert np.linalg.eigvalsh(found.covariance).max() < 1.0


def test_one_range_tells_the_distance_and_nothing_across():
    one = Ranges(np.array([[0.0, 0.0]]), np.zeros(1), np.array([8.0]), np.array([0.1]))
    found = corrected(track(10.0, 0.0, 4.0), one)
    assert found.mean == pytest.approx([8.0, 0.0], abs=0.01)
    assert found.covariance[1, 1] == pytest.approx(4.0)
    assert found.covariance[0, 0] < 0.011


def test_a_range_at_the_beacon_itself_changes_nothing():
    found = corrected(
        track(0.0, 0.0),
        Ranges(np.zeros((1, 2)), np.zeros(1), np.array([1.0]), np.array([0.5])),
    )
    assert found.mean == pytest.approx([0.0, 0.0])
    assert found.covariance == pytest.approx(9.0 * np.eye(2))


def test_the_deviation_of_a_range_grows_as_levels_say_it_does():
    rng = np.random.default_rng(11)
    anchors = [Anchor("a", ("k",), "f", 0.0, 0.0, path_loss_exponent=2.4)]
    model = level_model(anchors)
    for distance in (4.0, 12.0):
        level = expected_levels(model, np.array([distance]), np.zeros(1))[0]
        # Small enough that first order holds; it scales.
        noisy = level + 0.1 * rng.normal(size=(4000, 1))
        spread = distances_of_levels(model, noisy).std()
        params = RangeEkfParams(shadowing_db=0.1, least_range_sigma_m=0.0)
        told = range_sigma_m(np.array([distance]), model.table[:, SLOPE], params)
        assert told[0] == pytest.approx(spread, rel=0.05)


def test_published_noise_is_about_half_the_distance():
    model = level_model([Anchor("a", ("k",), "f", 0.0, 0.0, path_loss_exponent=2.0)])
    told = range_sigma_m(np.array([10.0, 0.1]), model.table[:, SLOPE], PARAMS)
    assert told == pytest.approx([4.73, 0.5], abs=0.01)


def test_a_place_pulls_by_its_share_of_trust():
    found = pulled(track(0.0, 0.0, 4.0), np.array([10.0, 0.0]), np.diag([4.0, 4.0]))
    assert found.mean == pytest.approx([5.0, 0.0])
    assert found.covariance == pytest.approx(np.eye(2) * 2.0)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-5.0, 25.0), st.floats(-5.0, 20.0), st.floats(0.3, 10.0), st.permutations(range(4))
)
def test_the_order_of_ranges_is_free_and_they_never_widen(x, y, sigma_m, order):
    ranges = ranges_from(np.array([8.0, 5.0]), sigma_m)
    turned = Ranges(
        ranges.places[order], ranges.dz2_m2, ranges.range_m[order], ranges.sigma_m[order]
    )
    one, other = corrected(track(x, y), ranges), corrected(track(x, y), turned)
    assert one.mean == pytest.approx(other.mean, abs=1e-9)
    assert np.linalg.eigvalsh(9.0 * np.eye(2) - one.covariance).min() > -1e-9
