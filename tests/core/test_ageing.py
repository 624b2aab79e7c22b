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
from app.core.fingerprint.contradiction import hearings, learned_weights
from app.core.fingerprint.matching import match
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
    suspects = aged(renamed(traffic(3), {FIRST: LAST, LAST: FIRST}), radio_map)
    assert {s.key for s in suspects} == {FIRST, LAST}
    assert {s.change for s in suspects} == {Change.MOVED}
    assert all(s.excess > PARAMS.excess and s.scans > 0 for s in suspects)


def test_a_silent_transmitter_has_vanished(radio_map: RadioMap):
    (suspect,) = aged(renamed(traffic(4), {FIRST: None}), radio_map)
    assert (suspect.key, suspect.change, suspect.scans) == (FIRST, Change.VANISHED, 0)
    assert suspect.misplaced == 0 < suspect.expected


def test_little_traffic_accuses_nobody(radio_map: RadioMap):
    assert aged(renamed(traffic(5, scans=5), {FIRST: LAST, LAST: FIRST}), radio_map) == []


def test_scans_of_one_visit_say_no_more_than_one_of_them(radio_map: RadioMap):
    scans = renamed(traffic(8, scans=40), {FIRST: None})
    weights = learned_weights(radio_map, MATCHING)

    def excess(sessions: list[list[Query]]) -> float:
        (suspect,) = find_aged(sessions, radio_map, weights, MATCHING, PARAMS)
        assert suspect.key == FIRST
        return suspect.excess

    once = excess([[scan] for scan in scans])
    assert excess([[scan] * 5 for scan in scans]) == pytest.approx(once)
    assert excess([[scan] for scan in scans] * 5) > 1.5 * once


def test_a_survey_of_one_walk_cannot_tell_what_is_usual(radio_map: RadioMap):
    one_walk = replace(radio_map, survey_walks=("walk",) * radio_map.rows)
    weights = learned_weights(one_walk, MATCHING)
    assert not weights.heard.any()
    assert not weights.silent.any()
    assert aged(renamed(traffic(4), {FIRST: None}), one_walk) == []


def test_the_better_the_map_knows_a_place_the_more_a_surprise_there_says(radio_map: RadioMap):
    weights = learned_weights(radio_map, MATCHING)
    here = Query(levels_dbm(10.0, 10.0), {})
    without = Query({k: v for k, v in here.wifi_dbm.items() if k != FIRST}, {})
    (as_mapped,), (missing,) = (
        list(hearings([(query, match(here, radio_map, MATCHING))], radio_map))
        for query in (here, without)
    )
    assert as_mapped is not None
    assert missing is not None
    told = dict(zip(as_mapped.column.tolist(), weights.of(as_mapped).tolist(), strict=True))
    surprise = dict(zip(missing.column.tolist(), weights.of(missing).tolist(), strict=True))
    column = radio_map.column_by_key[FIRST]
    assert told[column] < 0.0 < surprise[column]
    del told[column]
    del surprise[column]
    assert told == surprise


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
