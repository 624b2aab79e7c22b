"""The phone's level offset: learned from what scans resemble, and taken off before matching."""

import numpy as np
import pytest

from app.core.fingerprint.heard import heard_in
from app.core.fingerprint.level_offset import LevelOffset, first_offset, learned
from app.core.fingerprint.matching import match, match_heard
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.params import LevelOffsetParams, MatchParams

MATCHING, PARAMS = MatchParams(), LevelOffsetParams()
ACCESS_POINTS = np.array([(x, y) for x in (0.0, 20.0, 40.0) for y in (0.0, 15.0, 30.0)])


def levels_at(x_m: float, y_m: float, rng: np.random.Generator, noise_db: float = 2.0):
    distance_m = np.hypot(*(ACCESS_POINTS - (x_m, y_m)).T)
    level_dbm = -35.0 - 25.0 * np.log10(np.maximum(distance_m, 1.0))
    noisy = level_dbm + rng.normal(0.0, noise_db, len(level_dbm))
    return {f"ap{i}": float(level) for i, level in enumerate(noisy)}


@pytest.fixture(scope="module")
def radio_map():
    rng = np.random.default_rng(1)
    grid = [(x, y) for x in np.arange(0.0, 41.0, 3.0) for y in np.arange(0.0, 31.0, 3.0)]
    return build_radio_map(["f"], [Fingerprint(0, x, y, levels_at(x, y, rng), {}) for x, y in grid])


def follow(radio_map, offset_db, scans=12):
    """Return the offset after scans along a walk, and the mean error of the matches."""
    rng = np.random.default_rng(2)
    offset, errors_m = None, []
    for i in range(scans):
        x_m, y_m = 5.0 + 2.5 * i, 15.0
        heard = {k: v + offset_db for k, v in levels_at(x_m, y_m, rng).items()}
        told = heard_in(Query(heard, {}), radio_map)
        offset = offset or first_offset(told, radio_map, MATCHING, PARAMS)[0]
        told = told.less(offset.mean_db)
        matches = match_heard(told, radio_map, MATCHING)
        errors_m.append(
            np.hypot(matches.weight @ matches.x_m - x_m, matches.weight @ matches.y_m - y_m)
        )
        offset = learned(offset, told, matches, radio_map, PARAMS)
    return offset, float(np.mean(errors_m))


@pytest.mark.parametrize("offset_db", [-10.0, -4.0, 0.0, 4.0, 10.0])
def test_a_planted_offset_is_found(radio_map, offset_db):
    offset, error_m = follow(radio_map, offset_db)
    assert offset.mean_db == pytest.approx(offset_db, abs=2.0)
    assert offset.variance_db2 < PARAMS.prior_db**2 / 4.0
    own_m = follow(radio_map, 0.0)[1]
    assert error_m < 1.15 * own_m


def test_without_learning_an_offset_of_10_db_costs_more_than_that(radio_map):
    rng = np.random.default_rng(2)
    errors_m = []
    for i in range(12):
        x_m, y_m = 5.0 + 2.5 * i, 15.0
        heard = {k: v + 10.0 for k, v in levels_at(x_m, y_m, rng).items()}
        found = match(Query(heard, {}), radio_map, MATCHING)
        errors_m.append(np.hypot(found.weight @ found.x_m - x_m, found.weight @ found.y_m - y_m))
    assert np.mean(errors_m) > 1.2 * follow(radio_map, 0.0)[1]


def test_few_or_weak_transmitters_tell_nothing(radio_map):
    known = LevelOffset(3.0, 9.0)
    heard = levels_at(20.0, 15.0, np.random.default_rng(3))
    for query in (
        Query(dict(list(heard.items())[: PARAMS.min_transmitters - 1]), {}),
        Query({key: min(level, PARAMS.least_dbm - 1.0) for key, level in heard.items()}, {}),
        Query({f"stranger{i}": -50.0 for i in range(9)} | {"ap4": -60.0}, {}),
    ):
        told = heard_in(query, radio_map)
        matches = match_heard(told, radio_map, MATCHING)
        assert matches is not None
        assert learned(known, told, matches, radio_map, PARAMS) == known


def test_the_order_of_readings_is_irrelevant(radio_map):
    heard = levels_at(12.0, 9.0, np.random.default_rng(4))
    one = heard_in(Query(heard, {}), radio_map)
    other = heard_in(Query(dict(reversed(heard.items())), {}), radio_map)
    start, matches = first_offset(one, radio_map, MATCHING, PARAMS)
    assert start == first_offset(other, radio_map, MATCHING, PARAMS)[0]
    assert (
        matches.distance.tolist()
        == match_heard(one.less(start.mean_db), radio_map, MATCHING).distance.tolist()
    )
    matches = match_heard(one, radio_map, MATCHING)
    assert learned(start, one, matches, radio_map, PARAMS) == learned(
        start, other, matches, radio_map, PARAMS
    )
