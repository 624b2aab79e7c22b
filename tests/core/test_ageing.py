from dataclasses import replace

import numpy as np
import pytest
from wifi_hall import SIDE_M, levels_dbm

from app.core.fingerprint.ageing import (
    AgeingParams,
    Change,
    Suspect,
    appeared,
    find_aged,
)
from app.core.fingerprint.contradiction import learned_weights
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.params import MatchParams

MATCHING, PARAMS = MatchParams(), AgeingParams()
FIRST, LAST = "mac:000000000000", "mac:00000000000b"
"""Access points in opposite corners."""


@pytest.fixture(scope="module")
def radio_map() -> RadioMap:
    rng = np.random.default_rng(1)
    grid = np.arange(0.0, SIDE_M + 1.0, 4.0).tolist()
    return build_radio_map(
        ("hall-F1",),
        [
            Fingerprint(0, x, y, levels_dbm(x, y, rng), {}, f"row-{y:.0f}-{turn}")
            for turn in range(2)
            for y in grid
            for x in grid
        ],
    )


def traffic(seed: int, scans: int = 300) -> list[Query]:
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, SIDE_M, (scans, 2))
    return [Query(levels_dbm(x, y, rng), {}) for x, y in places.tolist()]


def renamed(scans: list[Query], names: dict[str, str | None]) -> list[Query]:
    """Return the scans with transmitters under new names; those without one fall silent."""
    return [
        Query(
            {
                new: level
                for key, level in scan.wifi_dbm.items()
                if (new := names.get(key, key)) is not None
            },
            {},
        )
        for scan in scans
    ]


def aged(scans: list[Query], radio_map: RadioMap, params: AgeingParams = PARAMS) -> list[Suspect]:
    weights = learned_weights(radio_map, MATCHING)
    # Each scan is a session: traffic() jumps all over the hall.
    return find_aged([[scan] for scan in scans], radio_map, weights, MATCHING, params)


def test_traffic_like_the_survey_names_nobody(radio_map: RadioMap):
    assert aged(traffic(2), radio_map) == []


def test_transmitters_that_changed_places_have_moved(radio_map: RadioMap):
    # Of a dozen access points two that moved take the fixes along: their excess is small.
    params = replace(PARAMS, excess=0.05)
    suspects = aged(renamed(traffic(3), {FIRST: LAST, LAST: FIRST}), radio_map, params)
    assert {s.key for s in suspects[:2]} == {FIRST, LAST}
    assert {s.change for s in suspects} == {Change.MOVED}
    assert all(s.excess > params.excess and s.scans > 0 for s in suspects)


def test_a_silent_transmitter_has_vanished(radio_map: RadioMap):
    (suspect,) = aged(renamed(traffic(4), {FIRST: None}), radio_map)
    assert (suspect.key, suspect.change, suspect.scans) == (FIRST, Change.VANISHED, 0)
    assert suspect.misplaced == 0 < suspect.expected


def test_little_traffic_accuses_nobody(radio_map: RadioMap):
    assert aged(renamed(traffic(5, scans=5), {FIRST: LAST, LAST: FIRST}), radio_map) == []


def test_no_traffic_accuses_nobody(radio_map: RadioMap):
    assert aged([], radio_map) == []


def test_an_unknown_transmitter_heard_often_has_appeared(radio_map: RadioMap):
    scans = renamed(traffic(6), {FIRST: "mac:ffffffffffff"})
    (new,) = appeared([scans], radio_map, PARAMS)
    assert (new.key, new.change) == ("mac:ffffffffffff", Change.APPEARED)
    assert new.scans == sum("mac:ffffffffffff" in scan.wifi_dbm for scan in scans)
    few = PARAMS.least_scans - 1
    passed_by = [s for s in scans if "mac:ffffffffffff" in s.wifi_dbm][:few]
    assert appeared([passed_by], radio_map, PARAMS) == []


def test_without_transmitters_the_rest_of_the_map_is_as_it_was(radio_map: RadioMap):
    left = radio_map.without_transmitters({FIRST})
    assert FIRST not in left.column_by_key
    assert left.rows == radio_map.rows
    for before, after in zip(_rows(radio_map), _rows(left), strict=True):
        assert after == {key: level for key, level in before.items() if key != FIRST}
    assert radio_map.without_transmitters(()) is radio_map


def _rows(radio_map: RadioMap) -> list[dict[str, float]]:
    return [
        {
            radio_map.transmitters[radio_map.column[entry]]: float(radio_map.rssi_dbm[entry])
            for entry in range(radio_map.row_start[row], radio_map.row_start[row + 1])
        }
        for row in range(radio_map.rows)
    ]
