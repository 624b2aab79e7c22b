"""The matcher's index: networks of one radio are one transmitter, and all others are themselves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.fingerprint.access_point import access_point_key
from app.core.fingerprint.match_index import match_index
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.params import MatchParams

PARAMS = MatchParams()
TAILS = st.integers(0, 2**40 - 1).map("{:010x}".format)
LOCAL, UNIVERSAL = (
    st.integers(0, 255).filter(lambda octet, bit=bit: octet & 2 == bit).map("{:02x}".format)
    for bit in (2, 0)
)
RADIO = [f"mac:{octet}749c2eadeb" for octet in ("06", "0a", "0e", "12", "16", "1e")]
OTHERS = [f"mac:0074aa00{i:04x}" for i in range(6)]


@given(LOCAL, LOCAL, TAILS)
def test_locally_administered_names_with_one_tail_are_one_radio(one, other, tail):
    key = access_point_key(f"mac:{one}{tail}")
    assert key == access_point_key(f"mac:{other}{tail}") == access_point_key(key)


@given(LOCAL, TAILS, TAILS)
def test_names_with_different_tails_are_different_radios(octet, one, other):
    keys = access_point_key(f"mac:{octet}{one}"), access_point_key(f"mac:{octet}{other}")
    assert (keys[0] == keys[1]) == (one == other)


@given(UNIVERSAL, TAILS)
def test_universal_names_are_themselves(octet, tail):
    assert access_point_key(f"mac:{octet}{tail}") == f"mac:{octet}{tail}"


@pytest.mark.parametrize("key", ["wap017", "ibeacon:fda50693-a4e2-4fb1-afcf-c6eb07647825:1:2", ""])
def test_other_names_are_themselves(key):
    assert access_point_key(key) == key


def spread(levels):
    """Hear a radio of one name by all its networks."""
    out = {key: dbm for key, dbm in levels.items() if key != RADIO[0]}
    return out | dict.fromkeys(RADIO, levels[RADIO[0]]) if RADIO[0] in levels else out


def unjoined(query, row):
    """Sørensen and cosine distance, each name for itself."""
    keys = sorted(query | row)
    a, b = (
        np.array([max(side.get(key, -100.0) + 100.0, 0.0) / 100.0 for key in keys]) ** 2
        for side in (query, row)
    )
    shared = 1.0 - 2.0 * np.minimum(a, b).sum() / (a.sum() + b.sum())
    return shared, 1.0 - a @ b / np.sqrt((a @ a) * (b @ b))


@pytest.mark.parametrize("seed", range(4))
def test_where_networks_are_heard_alike_joining_them_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    keys = [RADIO[0], *OTHERS]
    scans = [
        spread({str(key): float(rng.integers(-90, -40)) for key in rng.choice(keys, 4, False)})
        for _ in range(12)
    ]
    radio_map = build_radio_map(
        ("f",), [Fingerprint(0, 9.0 * i, 0.0, scan, {}) for i, scan in enumerate(scans[1:])]
    )
    found = match(Query(scans[0], {}), radio_map, replace(PARAMS, k=11))
    for row, distance, sorensen in zip(found.row, found.distance, found.sorensen, strict=True):
        expected = unjoined(scans[0], scans[1:][row])
        assert sorensen == pytest.approx(expected[0], abs=1e-12)
        assert distance == pytest.approx(sum(expected), abs=1e-12)


def test_a_place_is_known_by_whichever_networks_of_a_radio_were_heard_there():
    here = {RADIO[0]: -50.0, OTHERS[0]: -60.0}
    there = {RADIO[1]: -85.0, OTHERS[0]: -60.0}
    radio_map = build_radio_map(
        ("f",), [Fingerprint(0, 0.0, 0.0, here, {}), Fingerprint(0, 20.0, 0.0, there, {})]
    )
    found = match(Query({RADIO[1]: -50.0, OTHERS[0]: -60.0}, {}), radio_map, PARAMS)
    assert found.row[0] == 0
    assert found.distance[0] == pytest.approx(0.0, abs=1e-12)


def test_one_radio_is_one_entry_of_a_fingerprint():
    scan = dict.fromkeys(RADIO, -50.0) | dict.fromkeys(OTHERS, -60.0)
    beacons = {"mac:22749c2eadeb": -70.0, "mac:26749c2eadeb": -70.0}
    radio_map = build_radio_map(("f",), [Fingerprint(0, 0.0, 0.0, scan, beacons)])
    index = match_index(radio_map, PARAMS)
    # Beacons are never networks of each other, whatever their addresses.
    assert len(index.row) == 1 + len(OTHERS) + len(beacons)
    assert index.start[-1] == len(index.row)
