"""A reference point keeps one cleaned level per transmitter, and how the levels scattered."""

import numpy as np
import pytest

from app.core.fingerprint.cleaning import CleaningParams, gauss_mean_dbm
from app.core.fingerprint.point_survey import cleaned_points, level_statistics
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK

A, B, C = "mac:000000000001", "mac:000000000002", "mac:000000000003"
LEVELS = [-60.0, -61.0, -59.0, -60.0, -80.0]


def scans() -> list[Fingerprint]:
    """Return five scans at one point, one of which alone hears B, and one scan elsewhere."""
    here = [Fingerprint(0, 1.0, 2.0, {A: level}, {C: -70.0}, "p") for level in LEVELS]
    here[1].wifi_dbm[B] = -75.0
    return [*here, Fingerprint(0, 5.0, 2.0, {A: -50.0}, {}, "q")]


def test_a_point_is_cleaned_and_its_scatter_kept() -> None:
    one, other = cleaned_points(scans(), CleaningParams())
    assert one.fingerprint.wifi_dbm[A] == gauss_mean_dbm(np.array(LEVELS), CleaningParams())
    assert one.fingerprint.wifi_dbm[A] > -61.0
    assert (one.fingerprint.wifi_dbm[B], one.fingerprint.ble_dbm) == (-75.0, {C: -70.0})
    deviation_db, count, heard_share = one.scatter[A]
    assert (count, heard_share) == (5, 1.0)
    assert 0.5 < deviation_db < 3.0
    assert one.scatter[B] == (0.0, 1, pytest.approx(0.2))
    assert other.fingerprint.wifi_dbm == {A: -50.0}


def test_walks_and_floors_are_kept_apart() -> None:
    apart = [
        Fingerprint(0, 1.0, 2.0, {A: -60.0}, {}, "p"),
        Fingerprint(0, 1.0, 2.0, {A: -60.0}, {}, "q"),
        Fingerprint(1, 1.0, 2.0, {A: -60.0}, {}, "p"),
    ]
    assert len(cleaned_points(apart, CleaningParams())) == 3


def test_the_scatter_lies_beside_the_levels_of_the_map() -> None:
    points = cleaned_points(scans(), CleaningParams())
    walked = Fingerprint(0, 9.0, 2.0, {B: -66.0}, {}, "walk")
    virtual = Fingerprint(0, 12.0, 2.0, {C: -90.0, A: -90.0}, {}, VIRTUAL_WALK)
    rows = [walked, *(point.fingerprint for point in points), virtual]
    radio_map = build_radio_map(("f",), rows)
    statistics = level_statistics(radio_map, {i + 1: p.scatter for i, p in enumerate(points)})
    told = {}
    for row in range(radio_map.rows):
        for entry in range(radio_map.row_start[row], radio_map.row_start[row + 1]):
            key = radio_map.transmitters[radio_map.column[entry]]
            told[row, key] = (
                statistics.deviation_db[entry],
                statistics.count[entry],
                statistics.heard_share[entry],
            )
    assert told[0, B] == (0.0, 1, 1.0)
    assert told[1, A] == points[0].scatter[A]
    assert told[1, B] == points[0].scatter[B]
    assert told[3, A] == told[3, C] == (0.0, 0, 0.0)
