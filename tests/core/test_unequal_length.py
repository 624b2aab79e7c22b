"""Nearest neighbours on scans of unequal length."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.unequal_length import (
    Neighbours,
    UnequalLengthParams,
    nearest_of_unequal_length,
)

PLAIN = UnequalLengthParams(strength_exponent=0.0, absence_db=20.0, most_db=1e9)


def radio_map(*levels_dbm: dict[str, float]):
    return build_radio_map(
        ("f",), [Fingerprint(0, float(i), 0.0, levels, {}) for i, levels in enumerate(levels_dbm)]
    )


def distances(scan: dict[str, float], params: UnequalLengthParams, *levels_dbm) -> dict[int, float]:
    found = nearest_of_unequal_length(scan, radio_map(*levels_dbm), params)
    assert isinstance(found, Neighbours)
    return dict(zip(found.row.tolist(), found.distance_db.tolist(), strict=True))


def test_only_common_access_points_are_compared_and_absence_costs() -> None:
    found = distances(
        {"a": -50.0, "b": -60.0},
        PLAIN,
        {"a": -54.0, "b": -60.0},
        {"a": -54.0},
        {"a": -54.0, "b": -60.0, "c": -70.0, "d": -80.0},
    )
    assert found[0] == pytest.approx(math.sqrt((16 + 0) / 2))
    assert found[1] == pytest.approx(math.sqrt((16 + 400) / 2))
    assert found[2] == pytest.approx(math.sqrt((16 + 0 + 400 + 400) / 4))


def test_a_common_access_point_never_counts_more_than_the_most() -> None:
    capped = UnequalLengthParams(strength_exponent=0.0, most_db=10.0)
    assert distances({"a": -30.0}, capped, {"a": -80.0})[0] == pytest.approx(10.0)


def test_a_strong_access_point_says_more_than_a_weak_one() -> None:
    params = UnequalLengthParams()
    strong, weak = {"a": -40.0, "b": -80.0}, {"a": -40.0, "b": -90.0}
    found = distances({"a": -50.0, "b": -80.0}, params, strong, {"a": -50.0, "b": -90.0}, weak)
    assert found[1] < found[0] < found[2]


def test_unknown_access_points_and_bluetooth_are_not_passed_over_alike() -> None:
    params = PLAIN
    known = distances({"a": -50.0}, params, {"a": -50.0})[0]
    with_unknown = distances({"a": -50.0, "x": -50.0}, params, {"a": -50.0})[0]
    assert known == 0.0
    assert with_unknown == pytest.approx(math.sqrt(400 / 2))
    heard_too = Fingerprint(0, 0.0, 0.0, {"a": -50.0}, {"beacon": -50.0})
    found = nearest_of_unequal_length({"a": -50.0}, build_radio_map(("f",), [heard_too]), PLAIN)
    assert found is not None
    assert found.distance_db[0] == 0.0


def test_a_scan_of_strangers_has_no_neighbours() -> None:
    assert nearest_of_unequal_length({"x": -50.0}, radio_map({"a": -50.0}), PLAIN) is None


levels = st.dictionaries(st.sampled_from("abcdef"), st.integers(-95, -30).map(float), min_size=1)


@given(levels, st.lists(levels, min_size=1, max_size=6))
def test_a_scan_is_nearest_to_itself_and_weights_are_shares(
    scan: dict[str, float], others: list[dict[str, float]]
) -> None:
    found = nearest_of_unequal_length(scan, radio_map(*others, scan), UnequalLengthParams())
    assert found is not None
    assert found.distance_db[0] == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.diff(found.distance_db) >= 0.0)
    assert np.all(found.distance_db <= UnequalLengthParams().absence_db + 1e-9)
    assert found.weight.sum() == pytest.approx(1.0)
