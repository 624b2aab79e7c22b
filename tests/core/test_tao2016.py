"""The profile tao2016: smoothed levels, cleaned reference points, and their mean as the track."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import PROFILES, SessionState, advance, finish, start
from app.core.engine.tao2016 import Tao2016Params
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fusion.planar import PlanarTrack
from app.core.radio.level_smoothing import LevelMemory
from app.core.site import Floor, SiteModel
from app.core.types import (
    BleScan,
    Method,
    NoFix,
    NoFixReason,
    Observation,
    Output,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)
from app.storage.codec import TreeCodec

PARAMS = PROFILES["tao2016"].params
assert isinstance(PARAMS, Tao2016Params)
BEACON_X_M = (0.0, 10.0, 20.0, 30.0)
T0 = 1000.0


def levels_dbm(x_m: float) -> list[float]:
    return [-60.0 - 20.0 * math.log10(math.hypot(x_m - b, 2.0)) for b in BEACON_X_M]


def key(beacon: int) -> str:
    return f"mac:{beacon:012x}"


def row(x_m: float, blocked_db: float = 0.0) -> Fingerprint:
    heard = {key(b): u - blocked_db * (b == 0) for b, u in enumerate(levels_dbm(x_m))}
    return Fingerprint(0, x_m, 1.5, {}, heard)


def site_of(rows: Iterable[Fingerprint]) -> SiteModel:
    floor = Floor("f", "Ground", "b", 0, 0.0, 0.0, 30.0, 3.0)
    return SiteModel("s", 1, (floor,), radio_map=build_radio_map(("f",), list(rows)))


@pytest.fixture(scope="module")
def site() -> SiteModel:
    """A corridor with a reference point every 3 m, one of five scans behind a body."""
    places = np.arange(1.5, 30.0, 3.0).tolist()
    return site_of(row(x, blocked) for x in places for blocked in (0.0, 0.0, 0.0, 0.0, 20.0))


def scan(x_m: float, time_s: float, noise_db: Iterable[float] = ()) -> BleScan:
    noise = [*noise_db] or [0.0] * len(BEACON_X_M)
    heard = enumerate(zip(levels_dbm(x_m), noise, strict=True))
    return BleScan(time_s, tuple(Reading((key(b),), u + n) for b, (u, n) in heard))


def fold(
    observations: Iterable[Observation], site: SiteModel, params: Tao2016Params = PARAMS
) -> tuple[SessionState, Output]:
    state = start()
    for observation in observations:
        state, _ = advance(state, observation, site, params)
    return state, finish(state, site, params)[-1]


def point(observations: Iterable[Observation], site: SiteModel) -> TrackPoint:
    _, last = fold(observations, site)
    assert isinstance(last, TrackPoint)
    return last


def test_a_phone_at_a_reference_point_is_there(site: SiteModel) -> None:
    found = point([scan(13.5, T0 + i) for i in range(5)], site)
    assert found.x_m == pytest.approx(13.5, abs=0.8)
    assert (found.method, found.profile, found.used.beacons) == (Method.FINGERPRINT, "tao2016", 4)
    assert found.y_m == pytest.approx(1.5)


def test_a_body_in_one_survey_scan_of_five_changes_nothing(site: SiteModel) -> None:
    unblocked = site_of(row(x) for x in np.arange(1.5, 30.0, 3.0).tolist())
    for x_m in (4.5, 6.0, 22.0):
        found, expected = point([scan(x_m, T0)], site), point([scan(x_m, T0)], unblocked)
        assert (found.x_m, found.y_m) == pytest.approx((expected.x_m, expected.y_m))


def test_a_phone_at_rest_is_quieter_than_its_scans(site: SiteModel) -> None:
    noise = np.random.default_rng(5).normal(0.0, 3.0, (80, len(BEACON_X_M)))
    heard = [scan(13.5, T0 + i, each) for i, each in enumerate(noise.tolist())]
    xs = [point(heard[: i + 1], site).x_m for i in range(20, 80, 4)]
    single = [point([each], site).x_m for each in heard[20::4]]
    assert np.std(xs) < 0.6 * np.std(single)


def test_a_phone_carried_off_is_followed(site: SiteModel) -> None:
    there = [scan(4.5, T0 + i) for i in range(30)]
    away = [scan(25.5, T0 + 30 + i) for i in range(8)]
    assert point([*there, *away], site).x_m == pytest.approx(25.5, abs=1.5)


def test_steps_do_not_move_it(site: SiteModel) -> None:
    heard = [scan(13.5, T0), scan(13.5, T0 + 1)]
    walked = [*heard, Steps(T0 + 1.5, 4, 0.7, 0.0)]
    assert point(walked, site).x_m == point(heard, site).x_m


def test_with_wifi_about_beacons_wait_for_its_next_scan() -> None:
    rows = [
        replace(row(x), wifi_dbm={"mac:aa0000000000": -50.0 - x, "mac:aa0000000001": -80.0 + x})
        for x in np.arange(1.5, 30.0, 3.0).tolist()
    ]
    both = site_of(rows)
    assert fold([scan(13.5, T0), scan(13.5, T0 + 1)], both)[1] == NoFix(
        T0 + 1, NoFixReason.NOT_STARTED
    )
    wifi = (Reading(("mac:aa0000000000",), -63.5), Reading(("mac:aa0000000001",), -66.5))
    found = point([scan(13.5, T0), WifiScan(T0 + 1, wifi)], both)
    assert (found.used.beacons, found.used.access_points) == (4, 2)
    # A phone that does not scan Wi-Fi is placed by beacons alone.
    lonely = [scan(13.5, T0 + i) for i in range(15)]
    assert point(lonely, both).used.access_points == 0


def test_without_what_it_needs_it_says_why(site: SiteModel) -> None:
    def reason(heard: BleScan, of_site: SiteModel) -> NoFixReason:
        last = fold([heard], of_site)[1]
        assert isinstance(last, NoFix)
        return last.reason

    stranger = BleScan(T0, (Reading(("mac:ffffffffffff",), -60.0),))
    few = BleScan(T0, scan(13.5, T0).readings[:2])
    assert reason(stranger, site) is NoFixReason.UNKNOWN_TRANSMITTERS
    assert reason(BleScan(T0, ()), site) is NoFixReason.NOTHING_HEARD
    assert reason(few, site) is NoFixReason.TOO_FEW_TRANSMITTERS
    mapless = replace(site, radio_map=None)
    assert reason(scan(13.5, T0), mapless) is NoFixReason.NO_RADIO_MAP_OR_BEACONS


def test_its_state_is_stored_losslessly(site: SiteModel) -> None:
    heard = [scan(13.5, T0 + i) for i in range(4)]
    state, _ = fold(heard, site)
    assert isinstance(state.track, PlanarTrack)
    codec = TreeCodec(SessionState)
    restored = codec.decode(codec.encode(state))
    assert isinstance(restored.memory, LevelMemory)
    assert restored.memory == state.memory
    following = scan(14.0, T0 + 4)
    _, outputs = advance(restored, following, site, PARAMS)
    assert outputs == advance(state, following, site, PARAMS)[1]
