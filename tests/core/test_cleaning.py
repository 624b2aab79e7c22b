"""Gauss-mean cleaning of a survey's levels."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fingerprint.cleaning import (
    MAX_DENSITY_RATIO,
    CleanedLevels,
    CleaningParams,
    clean_levels,
    gauss_mean_dbm,
)

PARAMS = CleaningParams()
# Standard deviation of a standard normal between -1.0108 and 1.0108 (by numerical integration).
NORMAL_KEPT = 0.5443
levels = st.lists(st.integers(-100, -30).map(float), min_size=1, max_size=30).map(np.array)


def cleaned(samples: dict[tuple[int, int], list[float]], scans: list[int]) -> CleanedLevels:
    rows = [(p, t, level) for (p, t), heard in samples.items() for level in heard]
    order = np.random.default_rng(0).permutation(len(rows))
    point, transmitter, rssi_dbm = (np.array(column)[order] for column in zip(*rows, strict=True))
    return clean_levels(point, transmitter, rssi_dbm.astype(float), np.array(scans), PARAMS)


def test_a_level_beyond_the_bound_does_not_count() -> None:
    # mu = -64, sigma = 8, so the bound is 8.09: the last level is 16 off.
    assert gauss_mean_dbm(np.array([-60.0, -60.0, -60.0, -60.0, -80.0]), PARAMS) == -60.0


@pytest.mark.parametrize(("outer_db", "is_kept"), [(5.10, True), (5.12, False)])
def test_the_bound_is_where_the_density_falls_to_the_ratio(outer_db: float, is_kept: bool) -> None:
    # Of +-a and +-c, sigma^2 = (a^2 + c^2) / 2, and a^2 <= 2 ln(1 / 0.6) sigma^2 is a <= 1.0218 c.
    sample = [-70.0 - outer_db, -70.0 + outer_db, -75.0, -65.0]
    outer = math.sqrt((outer_db**2 + 5.0**2) / 2.0) if is_kept else 5.0
    result = cleaned({(0, 0): sample}, [4])
    assert result.mean_dbm == pytest.approx([-70.0])
    assert result.deviation_db == pytest.approx([outer / NORMAL_KEPT], rel=1e-3)


def test_each_pair_of_point_and_transmitter_is_cleaned_apart() -> None:
    result = cleaned(
        {
            (2, 0): [-50.0],
            (0, 1): [-60.0, -60.0, -60.0, -60.0, -80.0],
            (0, 0): [-70.0, -72.0],
        },
        scans=[10, 3, 1],
    )
    assert result.point.tolist() == [0, 0, 2]
    assert result.transmitter.tolist() == [0, 1, 0]
    assert result.mean_dbm.tolist() == [-71.0, -60.0, -50.0]
    assert result.count.tolist() == [2, 5, 1]
    assert result.heard_share.tolist() == [0.2, 0.5, 1.0]
    assert result.deviation_db == pytest.approx([1.0 / NORMAL_KEPT, 0.0, 0.0], rel=1e-3)


def test_a_map_and_a_single_sample_are_cleaned_alike() -> None:
    rng = np.random.default_rng(1)
    samples = {(p, t): rng.normal(-70.0, 6.0, 12).tolist() for p in range(3) for t in range(4)}
    result = cleaned(samples, [12, 12, 12])
    single = [gauss_mean_dbm(np.array(levels), PARAMS) for levels in samples.values()]
    assert result.mean_dbm == pytest.approx(single)


def test_the_deviation_of_normal_levels_is_their_own() -> None:
    sample = np.random.default_rng(2).normal(-70.0, 3.0, 20_000)
    assert cleaned({(0, 0): sample.tolist()}, [20_000]).deviation_db == pytest.approx(
        [3.0], rel=0.02
    )


def test_with_one_level_in_seven_too_low_the_error_is_half_that_of_the_mean() -> None:
    rng = np.random.default_rng(3)
    fading = rng.normal(0.0, 2.0, (500, 20))
    blocked = 12.0 * (rng.random((500, 20)) < 1.0 / 7.0)
    errors = [(gauss_mean_dbm(s, PARAMS), s.mean()) for s in fading - blocked]
    of_gauss_mean, of_mean = np.sqrt(np.square(errors).mean(axis=0))
    assert of_gauss_mean < 0.5 * of_mean


def test_nothing_heard_is_no_entry() -> None:
    none = np.empty(0, dtype=np.int64)
    assert not len(clean_levels(none, none, np.empty(0), np.array([3]), PARAMS).mean_dbm)


@settings(deadline=None, derandomize=True)
@given(levels)
def test_something_is_always_kept_and_lies_among_the_levels(rssi_dbm: np.ndarray) -> None:
    level_dbm = gauss_mean_dbm(rssi_dbm, CleaningParams(0.6065))
    assert rssi_dbm.min() <= level_dbm <= rssi_dbm.max()


@pytest.mark.parametrize("ratio", [0.0, MAX_DENSITY_RATIO * 1.001])
def test_a_ratio_that_could_keep_nothing_is_refused(ratio: float) -> None:
    with pytest.raises(ValueError, match="density ratio"):
        CleaningParams(ratio)
