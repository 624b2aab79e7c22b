"""Weighted nearest neighbours in signal space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fingerprint.wknn import (
    SignalSpace,
    WknnParams,
    mean_place,
    nearest,
    of_floor,
    signal_space,
)

PARAMS = WknnParams()
MISSING = PARAMS.missing_dbm


def space_of(levels_dbm: np.ndarray, params: WknnParams = PARAMS) -> SignalSpace:
    """Points in a row, 1 m apart; nan is not heard."""
    points, columns = levels_dbm.shape
    point, column = np.nonzero(~np.isnan(levels_dbm))
    order = np.random.default_rng(0).permutation(len(point))
    entries = (point[order], column[order], levels_dbm[point, column][order])
    x_m = np.arange(points, dtype=np.float64)
    places = (np.zeros(points, dtype=np.int64), x_m, np.zeros(points))
    return signal_space(places, entries, columns, params)


def test_distance_is_euclid_with_silence_at_the_missing_level() -> None:
    space = space_of(np.array([[-60.0, np.nan, -80.0], [np.nan, -90.0, np.nan]]))
    found = nearest({0: -63.0, 1: -96.0}, space, PARAMS)
    assert found is not None
    assert found.point.tolist() == [0, 1]
    # (-60 + 63), (-100 + 96), (-80 + 100); (-100 + 63), (-90 + 96).
    assert found.distance_db**2 == pytest.approx([9.0 + 16.0 + 400.0, 37.0**2 + 36.0])


def test_weights_are_one_over_the_distance() -> None:
    space = space_of(np.array([[-60.0], [-62.0], [-66.0], [-90.0]]))
    found = nearest({0: -63.0}, space, WknnParams(k=3))
    assert found is not None
    assert found.point.tolist() == [1, 0, 2]
    assert found.weight == pytest.approx(np.array([1.0, 1.0 / 3.0, 1.0 / 3.0]) / (5.0 / 3.0))
    mean, scatter = mean_place(found)
    assert mean == pytest.approx([(1.0 + 0.0 + 2.0 / 3.0) * 0.6, 0.0])
    assert scatter == pytest.approx(np.array([[0.4, 0.0], [0.0, 0.0]]))


def test_a_point_heard_exactly_weighs_finitely() -> None:
    found = nearest({0: -60.0}, space_of(np.array([[-60.0], [-61.0]])), PARAMS)
    assert found is not None
    assert found.weight == pytest.approx([2.0 / 3.0, 1.0 / 3.0])


def test_of_equally_near_points_the_first_of_the_map_count() -> None:
    found = nearest({0: -60.0}, space_of(np.full((50, 1), -70.0)), PARAMS)
    assert found is not None
    assert found.point.tolist() == [0, 1, 2, 3]


def test_an_empty_map_has_no_neighbours() -> None:
    assert nearest({0: -60.0}, space_of(np.empty((0, 1))), PARAMS) is None


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10_000))
def test_the_inverted_index_agrees_with_the_sum_over_all_transmitters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels_dbm = rng.integers(-105, -40, (30, 12)).astype(float)
    levels_dbm[rng.random(levels_dbm.shape) < 0.6] = np.nan
    query = np.where(rng.random(12) < 0.5, rng.uniform(-99.0, -40.0, 12), np.nan)
    heard = {int(t): float(query[t]) for t in np.flatnonzero(~np.isnan(query))}
    found = nearest(heard, space_of(levels_dbm), PARAMS)
    assert found is not None

    def filled(levels: np.ndarray) -> np.ndarray:
        return np.maximum(np.where(np.isnan(levels), MISSING, levels), MISSING)

    distance_db = np.linalg.norm(filled(levels_dbm) - filled(query), axis=1)
    assert found.distance_db == pytest.approx(np.sort(distance_db)[:4])
    assert distance_db[found.point] == pytest.approx(found.distance_db)


def test_neighbours_of_a_floor_share_the_weight_anew() -> None:
    places = (np.array([0, 1, 0]), np.arange(3.0), np.zeros(3))
    entries = (np.arange(3), np.zeros(3, dtype=np.int64), np.array([-61.0, -62.0, -63.0]))
    found = nearest({0: -60.0}, signal_space(places, entries, 1, PARAMS), PARAMS)
    assert found is not None
    here = of_floor(found, 0)
    assert here is not None
    assert here.point.tolist() == [0, 2]
    assert here.weight == pytest.approx([0.75, 0.25])
    assert of_floor(found, 2) is None
