"""Fingerprint matching: the index is exact; what is heard late or twice does no harm."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.fingerprint.match_index import represent
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query, first_of, fresh_wifi_dbm, hear, mean_ble_dbm
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map, joined
from app.core.fingerprint.survey import chosen_keys, walk_fingerprints
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.params import MatchParams
from app.core.types import BleScan, Reading, WifiScan

PARAMS = MatchParams()


def levels(rng, prefix, transmitters, heard):
    chosen = rng.choice(transmitters, heard, replace=False)
    return {f"{prefix}:{t}": float(rng.integers(-95, -35)) for t in chosen}


@pytest.fixture(scope="module")
def fingerprints():
    rng = np.random.default_rng(5)
    return [
        Fingerprint(i % 2, float(i), float(i % 7), levels(rng, "w", 40, 12), levels(rng, "b", 9, 3))
        for i in range(120)
    ]


@pytest.fixture(scope="module")
def radio_map(fingerprints):
    return build_radio_map(("f0", "f1"), fingerprints)


def sorensen(query, row, floor_dbm, exponent):
    keys = sorted(set(query) | set(row))
    a, b = (
        represent(np.array([side.get(k, floor_dbm) for k in keys]), floor_dbm, exponent)
        for side in (query, row)
    )
    return 1.0 - 2.0 * np.minimum(a, b).sum() / (a.sum() + b.sum())


def cosine(query, row, floor_dbm, exponent):
    keys = sorted(set(query) | set(row))
    a, b = (
        represent(np.array([side.get(k, floor_dbm) for k in keys]), floor_dbm, exponent)
        for side in (query, row)
    )
    return 1.0 - a @ b / np.sqrt((a @ a) * (b @ b))


@pytest.mark.parametrize("seed", range(6))
def test_the_index_finds_what_brute_force_finds(seed, fingerprints, radio_map):
    rng = np.random.default_rng(seed)
    query = Query(levels(rng, "w", 45, 10), levels(rng, "b", 12, 2))
    p = PARAMS
    gain = p.ble_gain * 2 / 3
    distance = np.array(
        [
            sorensen(query.wifi_dbm, f.wifi_dbm, p.wifi_floor_dbm, p.sorensen_exponent)
            + cosine(query.wifi_dbm, f.wifi_dbm, p.wifi_floor_dbm, p.cosine_exponent)
            + gain * sorensen(query.ble_dbm, f.ble_dbm, p.ble_floor_dbm, p.ble_exponent)
            for f in fingerprints
        ]
    )
    expected = np.argsort(distance)[: p.k]
    found = match(query, radio_map, p)
    assert list(found.row) == list(expected)
    crowd = [
        sum(
            f.floor_index == fingerprints[i].floor_index
            and np.hypot(f.x_m - fingerprints[i].x_m, f.y_m - fingerprints[i].y_m) <= p.crowd_m
            for f in fingerprints
        )
        for i in expected
    ]
    nearest = min(
        sorensen(query.wifi_dbm, fingerprints[i].wifi_dbm, p.wifi_floor_dbm, p.sorensen_exponent)
        for i in expected
    )
    softness = p.softness_ratio * nearest
    weight = np.exp(-(distance[expected] - distance[expected[0]]) / softness) / crowd
    assert np.allclose(found.weight, weight / weight.sum(), atol=1e-9)


def test_a_fingerprint_finds_itself(fingerprints, radio_map):
    for i in (0, 17, 119):
        found = match(Query(fingerprints[i].wifi_dbm, fingerprints[i].ble_dbm), radio_map, PARAMS)
        assert found.row[0] == i
        assert found.nearest_sorensen == pytest.approx(0.0, abs=1e-12)


def test_the_order_in_which_the_phone_lists_readings_does_not_matter(fingerprints, radio_map):
    forward = fingerprints[3].wifi_dbm
    backward = dict(reversed(forward.items()))
    one = match(Query(forward, {}), radio_map, PARAMS)
    other = match(Query(backward, {}), radio_map, PARAMS)
    assert np.array_equal(one.weight, other.weight)
    assert np.array_equal(one.row, other.row)


def test_beacons_alone_are_matched_by_beacons_alone(fingerprints, radio_map):
    found = match(Query({}, fingerprints[8].ble_dbm), radio_map, PARAMS)
    assert found.row[0] == 8 or found.nearest_sorensen == pytest.approx(0.0, abs=1e-12)


def test_nothing_known_is_no_match(radio_map):
    assert match(Query({"w:unknown": -50.0}, {}), radio_map, PARAMS) is None


def test_unknown_transmitters_count_against_every_place(fingerprints, radio_map):
    known = dict(fingerprints[3].wifi_dbm)
    strange = known | {f"w:new{i}": -40.0 for i in range(12)}
    assert (
        match(Query(strange, {}), radio_map, PARAMS).nearest_sorensen
        > match(Query(known, {}), radio_map, PARAMS).nearest_sorensen + 0.2
    )


def test_stale_readings_are_dropped_by_their_own_age():
    scan = WifiScan(
        100.0,
        (
            Reading(("mac:a",), -50.0, 0.2),
            Reading(("mac:b",), -40.0, 30.0),
            Reading(("mac:a",), -60.0, 0.1),
        ),
    )
    assert fresh_wifi_dbm(scan, 4.0, first_of({})) == {"mac:a": -50.0}


def test_beacon_levels_are_averaged_over_their_window():
    heard = hear((), BleScan(10.0, (Reading(("mac:a",), -60.0, 0.5),)), 3.0)
    heard = hear(heard, BleScan(11.0, (Reading(("mac:a",), -70.0),)), 3.0)
    assert mean_ble_dbm(heard, first_of({})) == {"mac:a": -65.0}
    heard = hear(heard, BleScan(13.5, (Reading(("mac:b",), -80.0),)), 3.0)
    assert mean_ble_dbm(heard, first_of({})) == {"mac:a": -70.0, "mac:b": -80.0}


def test_a_shared_beacon_identity_gives_way_to_the_mac():
    shared, own = "ibeacon:u:0:0", "ibeacon:u:1:7"
    scan = BleScan(
        1.0,
        (
            Reading((shared, "mac:1"), -60.0),
            Reading((shared, "mac:2"), -70.0),
            Reading((own, "mac:3"), -65.0),
        ),
    )
    choose = chosen_keys([scan])
    assert [choose(r.keys) for r in scan.readings] == ["mac:1", "mac:2", own]
    # An iPhone sees no MAC, an Android sees both: either finds the map's column.
    assert first_of({own: 0})((own,)) == first_of({own: 0})((own, "mac:3")) == own


def test_scans_that_cannot_be_placed_make_no_fingerprint():
    scans = [
        WifiScan(t, tuple(Reading((f"mac:{i}",), -50.0) for i in range(3))) for t in (1.0, 2.0, 3.0)
    ]
    place = {2.0: (4.0, 5.0)}
    rows = list(walk_fingerprints(scans, place.get, 0, "walk", (chosen_keys(scans), PARAMS)))
    assert [(r.x_m, r.y_m) for r in rows] == [(4.0, 5.0)]


def test_a_map_of_other_floors_is_refused_and_reordered(radio_map):
    swapped = radio_map.with_floors(("f1", "f0"))
    assert list(swapped.floor_index[:3]) == [1, 0, 1]
    only = radio_map.with_floors(("f1",))
    assert only.rows == radio_map.rows // 2
    with pytest.raises(ValueError, match="none of"):
        radio_map.with_floors(("elsewhere",))


def test_what_a_phone_without_wifi_surveyed_moves_no_phone_with_wifi(fingerprints, radio_map):
    beacons_alone = [
        replace(f, wifi_dbm={}, survey_walk="iphone") for f in fingerprints[:40] for _ in range(3)
    ]
    both = joined(radio_map, beacons_alone)
    for fingerprint in fingerprints[:60:7]:
        query = Query(fingerprint.wifi_dbm, fingerprint.ble_dbm)
        before, after = (match(query, known, PARAMS) for known in (radio_map, both))
        assert np.array_equal(before.row, after.row)
        assert np.allclose(before.weight, after.weight)


def test_a_virtual_fingerprint_counts_less_where_the_map_knows_a_scan_and_more_where_not():
    levels_dbm = {f"w{i}": -50.0 - i for i in range(6)}
    places = ((0.0, "a"), (9.0, VIRTUAL_WALK))
    radio_map = build_radio_map(
        ("f0",), [Fingerprint(0, x, 0.0, levels_dbm, {}, walk) for x, walk in places]
    )
    strange = {f"new{i}": -50.0 for i in range(9)}
    known, unknown = (
        match(Query(heard, {}), radio_map, PARAMS) for heard in (levels_dbm, levels_dbm | strange)
    )
    assert (known.row[0], unknown.row[0]) == (0, 1)
    assert known.weight[0] > 0.99
    for matches in (known, unknown):
        farther = matches.distance[matches.row == 1] - matches.distance[matches.row == 0]
        even = PARAMS.virtual_even_share - matches.nearest_sorensen
        assert farther == pytest.approx(PARAMS.virtual_gain * even)


def test_the_less_the_map_knows_a_scan_the_more_places_share_the_weight():
    near, far = (
        Fingerprint(0, x, 0.0, {"a": -50.0, "b": level_dbm}, {}, "walk")
        for x, level_dbm in ((0.0, -60.0), (50.0, -63.0))
    )
    radio_map = build_radio_map(("f0",), [near, far])
    shares = []
    for strange in (1, 3, 9):
        heard = {"a": -50.0, "b": -60.0} | {f"new{i}": -60.0 for i in range(strange)}
        shares.append(match(Query(heard, {}), radio_map, PARAMS).weight[1])
    assert shares == sorted(shares)
    assert shares[-1] > 1.5 * shares[0]
