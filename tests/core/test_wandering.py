"""Hotspots that moved and addresses that rotated are named on evidence; nobody else is."""

import math
from dataclasses import replace

import numpy as np
import pytest

from app.core.fingerprint.radio_map import Fingerprint
from app.core.fingerprint.wandering import Reason, WanderingParams, wanderers, without

PARAMS = WanderingParams()
# Locally administered, as most good access points of shopping centres are.
FIXED, OTHER = "mac:0242ac110001", "mac:0242ac110002"
DAY_S = 86_400.0


def heard(x_m: float, at_x_m: float, transmit_dbm: float = -30.0) -> float:
    return transmit_dbm - 25.0 * math.log10(max(abs(x_m - at_x_m), 1.0))


def corridor(time_s: float | None = 0.0, walk: str = "w") -> list[Fingerprint]:
    """Return a scan every 2 m of a corridor of 100 m, a second each, that hears a fixed one."""
    return [
        Fingerprint(
            0,
            x,
            0.0,
            {FIXED: heard(x, 50.0)},
            {},
            walk,
            None if time_s is None else time_s + x / 2.0,
        )
        for x in np.arange(0.0, 101.0, 2.0).tolist()
    ]


def also(scans: list[Fingerprint], levels: dict[int, float], key: str = OTHER) -> list[Fingerprint]:
    """Return the scans with further levels by their number."""
    for i, level_dbm in levels.items():
        scans[i].wifi_dbm[key] = level_dbm
    return scans


def test_a_survey_of_fixed_transmitters_names_none() -> None:
    assert wanderers([*corridor(), *corridor(DAY_S, "v")], PARAMS) == ()


def test_a_hotspot_that_was_loud_at_both_ends_has_moved() -> None:
    first, second = corridor(), corridor(DAY_S, "v")
    also(first, {i: heard(2.0 * i, 6.0) for i in range(10)})
    also(second, {i: heard(2.0 * i, 90.0) for i in range(40, 51)})
    (found,) = wanderers([*first, *second], PARAMS)
    assert (found.key, found.reason) == (OTHER, Reason.MOVED)
    assert "m apart" in found.evidence
    assert "-30" in found.evidence


def test_one_false_level_condemns_nobody() -> None:
    first = also(corridor(), {i: heard(2.0 * i, 6.0) for i in range(10)})
    second = also(corridor(DAY_S, "v"), {i: heard(2.0 * i, 6.0) for i in range(10)})
    second[45].wifi_dbm[OTHER] = -35.0
    assert wanderers([*first, *second], PARAMS) == ()
    second[46].wifi_dbm[OTHER] = -35.0
    assert [one.reason for one in wanderers([*first, *second], PARAMS)] == [Reason.MOVED]


def test_weak_levels_far_apart_are_no_evidence() -> None:
    scans = also(corridor(), {0: -80.0, 1: -82.0, 49: -80.0, 50: -82.0})
    assert wanderers([*scans, *corridor(DAY_S, "v")], PARAMS) == ()


def rotating(later: list[float | None]) -> list[Fingerprint]:
    """Return a walk that hears one more address at 20 to 40 m, and later walks that do not."""
    scans = also(corridor(), dict.fromkeys(range(10, 20), -60.0))
    for i, time_s in enumerate(later):
        scans += corridor(time_s, f"later {i}")
    return scans


def test_an_address_of_a_quarter_of_an_hour_has_rotated() -> None:
    (found,) = wanderers(rotating([3_600.0, DAY_S]), PARAMS)
    assert (found.key, found.reason) == (OTHER, Reason.ROTATED)
    assert "by none of" in found.evidence


@pytest.mark.parametrize(
    "later", [[], [600.0, 900.0], [None, None]], ids=["alone", "at once", "times unknown"]
)
def test_without_later_scans_there_is_no_evidence_of_rotation(later: list[float | None]) -> None:
    assert wanderers(rotating(later), PARAMS) == ()


def test_an_address_that_is_heard_again_has_not_rotated() -> None:
    scans = rotating([3_600.0, DAY_S])
    also([s for s in scans if s.survey_walk == "later 1"], {15: -62.0})
    assert wanderers(scans, PARAMS) == ()


def test_a_map_without_them_holds_the_others() -> None:
    scans = rotating([3_600.0, DAY_S])
    scans.append(Fingerprint(0, 0.0, 0.0, {OTHER: -50.0}, {}))
    kept = without(scans, frozenset({OTHER}))
    assert len(kept) == len(scans) - 1
    assert {key for scan in kept for key in scan.wifi_dbm} == {FIXED}


def test_walks_that_cannot_hear_a_radio_are_no_evidence_against_its_transmitters() -> None:
    """An iPhone hears no access point, and a phone that scans Wi-Fi alone hears no beacon."""
    with_wifi = [scan for walk in "ab" for scan in corridor(walk=walk)]
    beacons_alone = [
        replace(scan, wifi_dbm={}, ble_dbm={OTHER: -85.0})
        for walk in "cdefgh"
        for scan in corridor(DAY_S, walk)
    ]
    assert wanderers([*with_wifi, *beacons_alone], PARAMS) == ()
    # Phones that do hear Wi-Fi, and not that access point, are evidence.
    deaf = [replace(scan, wifi_dbm={OTHER: -60.0}, ble_dbm={}) for scan in beacons_alone]
    assert FIXED in {one.key for one in wanderers([*with_wifi, *deaf], PARAMS)}
