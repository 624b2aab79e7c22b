"""The profile zhu2018: what of a scan and of a stride its filter gets to see."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import PROFILES, SessionState, advance, finish, start
from app.core.engine.zhu2018 import mean_place
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.scheduled import ScheduledMemory
from app.core.fusion.sighting import Sighting
from app.core.site import Floor, SiteModel
from app.core.types import (
    Anchor,
    BleScan,
    Method,
    NoFix,
    NoFixReason,
    Observation,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

PARAMS = PROFILES["zhu2018"].params
SPACING_M, COUNT = 5.0, 13


def level_dbm(x_m: float, transmitter: int) -> float:
    return -40.0 - abs(x_m - 15.0 * transmitter)


def heard(x_m: float, kind: str) -> tuple[Reading, ...]:
    return tuple(Reading((f"mac:{kind}{i}",), level_dbm(x_m, i)) for i in range(5))


def corridor() -> SiteModel:
    """60 m along x on floor a; floor b, far off, is heard by other access points."""
    rows = []
    for i in range(COUNT):
        x_m = SPACING_M * i
        ble = {f"mac:b{j}": level_dbm(x_m, j) for j in range(5)}
        wifi = {f"mac:a{j}": level_dbm(x_m, j) for j in range(5)}
        rows.append(Fingerprint(0, x_m, 0.0, wifi, ble))
        rows.append(
            Fingerprint(1, x_m, 300.0, {f"mac:c{j}": level_dbm(x_m, j) for j in range(5)}, {})
        )
    floors = tuple(Floor(f, f, "", n, 0.0, 0.0, 60.0, 10.0) for n, f in enumerate("ab"))
    return SiteModel("corridor", 1, floors, (), build_radio_map(("a", "b"), rows))


SITE = corridor()


def folded(*observations: Observation) -> SessionState:
    state = start()
    for observation in observations:
        state, _ = advance(state, observation, SITE, PARAMS)
    return state


def place_m(state: SessionState) -> tuple[float, float]:
    assert isinstance(state.track, PlanarTrack)
    return float(state.track.mean[0]), float(state.track.mean[1])


def wifi_scan(time_s: float, x_m: float) -> WifiScan:
    return WifiScan(time_s, heard(x_m, "a"))


def test_the_first_fix_begins_the_track() -> None:
    state = folded(wifi_scan(100.0, 30.0))
    assert place_m(state) == pytest.approx((30.0, 0.0), abs=2.0)
    point = finish(state, SITE, PARAMS)[-1]
    assert isinstance(point, TrackPoint)
    assert (point.floor_id, point.method, point.profile) == ("a", Method.FINGERPRINT, "zhu2018")


def test_steps_before_the_first_fix_lead_nowhere() -> None:
    state = folded(Steps(99.0, 1, heading_rad=0.0), Steps(99.5, 1, heading_rad=0.0))
    assert (state.track, state.memory) == (None, None)
    assert isinstance(finish(state, SITE, PARAMS)[-1], NoFix)


def test_steps_move_the_track_between_fixes() -> None:
    before = folded(wifi_scan(100.0, 30.0))
    steps = [Steps(100.5, 1, heading_rad=0.0), Steps(101.0, 1, heading_rad=0.0)]
    state = before
    for step in steps:
        state, _ = advance(state, step, SITE, PARAMS)
    walked_m = 2.0 * PARAMS.step.usual_length_m
    assert place_m(state) == pytest.approx((place_m(before)[0] + walked_m, place_m(before)[1]))
    assert isinstance(state.memory, ScheduledMemory)
    assert state.memory.walked_m == pytest.approx((walked_m, 0.0))


def test_a_further_fix_is_fused() -> None:
    state = folded(wifi_scan(100.0, 30.0), wifi_scan(102.0, 40.0))
    assert 32.0 < place_m(state)[0] < 38.0
    assert state.method is Method.FUSED
    assert isinstance(state.memory, ScheduledMemory)
    assert state.memory.output_m == place_m(state)
    assert state.memory.told_s == 102.0


def test_beacons_alone_make_a_fix_each_second_once_wifi_is_not_to_be_expected() -> None:
    scans = [BleScan(100.0 + s, heard(30.0, "b")) for s in range(7)]
    told = [finish(folded(*scans[: i + 1]), SITE, PARAMS)[-1] for i in range(len(scans))]
    assert [isinstance(point, TrackPoint) for point in told] == [False] * 4 + [True] * 3
    state = folded(*scans)
    assert place_m(state) == pytest.approx((30.0, 0.0), abs=2.0)
    assert isinstance(state.memory, ScheduledMemory)
    assert (state.memory.began_s, state.memory.told_s) == (104.0, 106.0)


def test_a_scan_without_a_fix_leaves_the_filter_alone() -> None:
    before = folded(wifi_scan(100.0, 30.0))
    state, _ = advance(before, WifiScan(102.0, ()), SITE, PARAMS)
    assert state.track is before.track
    assert state.memory is before.memory


def test_without_a_radio_map_there_is_no_fix_and_that_is_why() -> None:
    anchors = tuple(Anchor(f"b{i}", (f"mac:b{i}",), "a", 15.0 * i, 0.0) for i in range(5))
    site = replace(SITE, anchors=anchors, radio_map=None)
    state, _ = advance(start(), BleScan(100.0, heard(30.0, "b")), site, PARAMS)
    (output,) = finish(state, site, PARAMS)
    assert isinstance(output, NoFix)
    assert output.reason is NoFixReason.NO_RADIO_MAP_OR_BEACONS


def test_a_fix_is_the_mean_of_the_candidates_on_the_floor_believed_in() -> None:
    sighting = Sighting(
        time_s=0.0,
        places=np.array([[0.0, 0.0], [4.0, 2.0], [50.0, 50.0]]),
        weight=np.array([0.2, 0.6, 0.2]),
        noise_m2=(1.0, 0.0, 1.0),
        floor_votes=np.array([0.8, 0.2, 0.0]),
        floor_index=np.array([0, 0, 1]),
    )
    assert mean_place(sighting, 0, 0.1) == pytest.approx((3.0, 1.5))
    assert mean_place(sighting, 1, 0.1) == pytest.approx((50.0, 50.0))
    assert mean_place(sighting, 1, 0.3) is None
    told_by_belief = replace(sighting, floor_index=None)
    assert mean_place(told_by_belief, 2, 0.1) == pytest.approx((12.4, 11.2))
    assert mean_place(sighting, 2, 0.1) is None


def test_a_fix_on_another_floor_than_believed_is_none() -> None:
    """The belief in floor a outweighs one scan of floor b."""
    before = folded(*(wifi_scan(100.0 + 2.0 * i, 30.0) for i in range(5)))
    assert before.floor_belief is not None
    before = replace(before, floor_belief=np.array([1.0 - 1e-9, 1e-9]))
    state, _ = advance(before, WifiScan(110.0, heard(30.0, "c")), SITE, PARAMS)
    assert state.track is before.track
