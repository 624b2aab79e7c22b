"""An explanation says what was heard, expected, weighed and decided, and the numbers are right."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.engine import PROFILES, advance, explained, finish, start
from app.core.engine.explanation import BlamedAnchor, Use
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fusion.ground import ground
from app.core.fusion.innovation import innovation_of_particles, innovation_of_planar
from app.core.fusion.particles import Particles, update
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.lateration.faults import Fault
from app.core.motion.mode import MotionEvidence
from app.core.params import FusionParams, Params
from app.core.site import Floor, SiteModel
from app.core.types import (
    Anchor,
    BleScan,
    ImuBlock,
    Method,
    MotionMode,
    NoFix,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

PARAMS = Params()
T0 = 1_700_000_000.0
FLOORS = tuple(Floor(f"f{i}", f"F{i}", "", i, 0.0, 0.0, 20.0, 10.0) for i in range(2))
CORNERS = ((0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0), (10.0, 5.0))
ANCHORS = (
    *(
        Anchor(f"a{i}", (f"mac:{i}", f"ibeacon:{i}"), "f0", x, y)
        for i, (x, y) in enumerate(CORNERS)
    ),
    Anchor("above", ("mac:above",), "f1", 6.0, 4.0),
)
BEACON_SITE = SiteModel("s", 1, FLOORS, ANCHORS)
ROWS = [
    Fingerprint(0, 4.0, 5.0, {"w0": -50.0, "w1": -60.0, "w2": -70.0}, {"b": -70.0}),
    Fingerprint(0, 8.0, 5.0, {"w0": -60.0, "w1": -52.0, "w2": -66.0}, {"b": -76.0}),
    Fingerprint(1, 4.0, 5.0, {"w0": -75.0, "w1": -85.0, "up": -50.0, "weak": -90.0}, {}),
]
MAP_SITE = SiteModel("s", 1, FLOORS, (), build_radio_map(("f0", "f1"), ROWS))


def level_dbm(anchor: Anchor, x_m: float, y_m: float) -> float:
    return -59.0 - 20.0 * math.log10(math.hypot(anchor.x_m - x_m, anchor.y_m - y_m))


def beacons_at(x_m: float, y_m: float, offset_db: float = 0.0, time_s: float = T0) -> BleScan:
    readings = [
        Reading(anchor.keys[1:], level_dbm(anchor, x_m, y_m) + offset_db) for anchor in ANCHORS[:5]
    ]
    return BleScan(time_s, tuple(readings))


def wifi(time_s: float = T0, **levels_dbm: float) -> WifiScan:
    readings = [Reading((key,), dbm) for key, dbm in levels_dbm.items()]
    return WifiScan(time_s, (*readings,))


def fold(site: SiteModel, *observations, state=None):
    state = state or start()
    for observation in observations:
        state, _ = advance(state, observation, site, PARAMS)
    return state


def why(site: SiteModel, *observations):
    state = fold(site, *observations)
    explanation = explained(state, site, PARAMS)
    assert explanation is not None
    assert explanation.output == finish(state, site, PARAMS)[-1]
    return explanation


def uses(explanation) -> dict[str, Use]:
    return {one.key: one.use for one in explanation.transmitters}


def test_nothing_seen_has_no_explanation() -> None:
    assert explained(start(), BEACON_SITE, PARAMS) is None


def test_anchors_are_compared_with_their_level_model_at_the_told_place() -> None:
    scan = beacons_at(6.0, 4.0)
    scan = replace(
        scan,
        readings=(
            *scan.readings[:4],
            replace(scan.readings[4], rssi_dbm=scan.readings[4].rssi_dbm - 9.0),
            Reading(("mac:above",), -80.0),
            Reading(("mac:stranger",), -40.0),
        ),
    )
    told = why(BEACON_SITE, scan)
    point = told.output
    assert isinstance(point, TrackPoint)
    assert (told.means, told.scan_s) == (Method.LATERATION, T0)
    assert uses(told) == {f"mac:{i}": Use.USED for i in range(5)} | {
        "mac:above": Use.OTHER_FLOOR,
        "mac:stranger": Use.UNKNOWN,
    }
    assert [one.heard_dbm for one in told.transmitters] == sorted(
        (reading.rssi_dbm for reading in scan.readings), reverse=True
    )
    by_key = {one.key: one for one in told.transmitters}
    for i, anchor in enumerate(ANCHORS[:5]):
        one = by_key[f"mac:{i}"]
        expected_dbm = level_dbm(anchor, point.x_m, point.y_m)
        assert one.anchor_id == f"a{i}"
        assert one.heard_dbm == pytest.approx(scan.readings[i].rssi_dbm)
        assert one.expected_dbm == pytest.approx(expected_dbm)
        assert one.residual_db == pytest.approx(scan.readings[i].rssi_dbm - expected_dbm)
    # The one that is 9 dB too weak stands out.
    worst = min(
        (one for one in told.transmitters if one.residual_db is not None),
        key=lambda one: one.residual_db,
    )
    assert worst.key == "mac:4"
    assert by_key["mac:stranger"].expected_dbm is None
    assert by_key["mac:above"].expected_dbm is None
    (candidate,) = told.candidates
    assert (candidate.floor_id, candidate.weight, candidate.seen_weight) == ("f0", 1.0, 1.0)
    assert told.gate is None


@pytest.mark.parametrize("offset_db", [-6.0, 0.0, 6.0])
def test_a_phones_level_offset_shows_in_its_residuals(offset_db: float) -> None:
    told = why(BEACON_SITE, beacons_at(6.0, 4.0, offset_db))
    assert told.level_offset_db == pytest.approx(offset_db, abs=1.5)


def test_fingerprints_are_compared_with_those_around_the_told_place() -> None:
    scan = wifi(w0=-50.0, w1=-58.0, w2=-70.0, weak=-100.0, stranger=-45.0)
    scan = replace(scan, readings=(*scan.readings, Reading(("up",), -50.0, age_s=5.0)))
    told = why(MAP_SITE, BleScan(T0 - 1.0, (Reading(("b",), -71.0),)), scan)
    point = told.output
    assert isinstance(point, TrackPoint)
    assert (told.means, point.floor_id) == (Method.FINGERPRINT, "f0")
    assert uses(told) == {
        **dict.fromkeys(("w0", "w1", "w2", "b"), Use.USED),
        "weak": Use.TOO_WEAK,
        "stranger": Use.UNKNOWN,
        "up": Use.TOO_OLD,
    }
    weight = [
        math.exp(-0.5 * ((row.x_m - point.x_m) ** 2 + (row.y_m - point.y_m) ** 2) / 9.0)
        for row in ROWS[:2]
    ]
    by_key = {one.key: one for one in told.transmitters}
    for key, kind in (("w0", "wifi"), ("w1", "wifi"), ("w2", "wifi"), ("b", "ble")):
        near_dbm = [(row.wifi_dbm | row.ble_dbm)[key] for row in ROWS[:2]]
        expected_dbm = np.average(near_dbm, weights=weight)
        one = by_key[key]
        assert one.kind == kind
        assert one.expected_dbm == pytest.approx(expected_dbm)
        assert one.residual_db == pytest.approx(one.heard_dbm - expected_dbm)
    # Nobody heard it on this floor.
    assert by_key["weak"].expected_dbm is None
    assert {place.floor_id for place in told.candidates} == {"f0", "f1"}
    assert sum(place.weight for place in told.candidates) == pytest.approx(1.0)
    votes = {floor.floor_id: floor.vote_share for floor in told.floors}
    of_f0 = sum(place.weight for place in told.candidates if place.floor_id == "f0")
    assert votes["f0"] == pytest.approx(of_f0)
    assert told.floors[0].probability == point.floor_confidence


def test_a_candidate_far_from_the_prediction_is_seen_as_light() -> None:
    rows = [
        replace(row, floor_index=0, x_m=x) for row, x in zip(ROWS[:2], (0.0, 60.0), strict=True)
    ]
    hall = Floor("f0", "F0", "", 0, 0.0, 0.0, 80.0, 10.0)
    site = SiteModel("s", 1, (hall,), (), build_radio_map(("f0",), rows))
    between = wifi(w0=-55.0, w1=-56.0, w2=-68.0)
    here = wifi(T0 + 1.0, w0=-50.0, w1=-60.0, w2=-70.0)
    told = why(site, here, replace(between, time_s=T0 + 2.0))
    near, far = told.candidates
    assert (near.x_m, far.x_m) == (0.0, 60.0)
    assert far.weight > 0.2
    assert far.seen_weight < 0.02
    assert near.seen_weight + far.seen_weight == pytest.approx(1.0)
    assert told.gate is not None
    assert told.gate.distance_m < 1.0


def test_a_jump_is_gated() -> None:
    still = [beacons_at(3.0, 3.0, time_s=T0 + i) for i in range(8)]
    calm = why(BEACON_SITE, *still).gate
    jump = why(BEACON_SITE, *still, beacons_at(18.0, 9.0, time_s=T0 + 11.0)).gate
    assert calm is not None
    assert jump is not None
    assert calm.inlier_probability > 0.7
    assert jump.distance_m > 5.0
    assert jump.nis > 5.0 * calm.nis
    assert jump.inlier_probability < 0.5


def test_a_faulty_beacon_is_named_and_gated() -> None:
    state = fold(BEACON_SITE, *(beacons_at(6.0, 4.0, time_s=T0 + i) for i in range(4)))
    assert state.told is not None
    healthy = explained(state, BEACON_SITE, PARAMS)
    assert healthy is not None
    assert healthy.faults == ()
    doubted = replace(
        state.told, evidence=replace(state.told.evidence, left_out={"a1": Fault.MOVED})
    )
    told = explained(replace(state, told=doubted), BEACON_SITE, PARAMS)
    assert told is not None
    assert told.faults == (BlamedAnchor("a1", Fault.MOVED),)
    assert {one.anchor_id for one in told.transmitters if one.use is Use.GATED} == {"a1"}


def test_where_nothing_is_known_the_reasons_are_told() -> None:
    lost = why(BEACON_SITE, BleScan(T0, (Reading(("mac:stranger",), -40.0),)))
    assert isinstance(lost.output, NoFix)
    assert (lost.means, lost.candidates, lost.gate, lost.level_offset_db) == (None, (), None, None)
    assert uses(lost) == {"mac:stranger": Use.UNKNOWN}
    few = why(MAP_SITE, wifi(w0=-50.0, w1=-58.0))
    assert uses(few) == dict.fromkeys(("w0", "w1"), Use.NO_FIX)
    assert [floor.vote_share for floor in few.floors] == [None, None]


def test_the_scan_that_told_the_place_is_explained_until_it_is_old() -> None:
    telling = wifi(w0=-50.0, w1=-58.0, w2=-70.0)
    state = fold(MAP_SITE, telling)
    for age_s in (1.0, 9.0):
        state = fold(MAP_SITE, BleScan(T0 + age_s, (Reading(("z",), -50.0),)), state=state)
        told = explained(state, MAP_SITE, PARAMS)
        assert told is not None
        assert told.scan_s == T0
        assert told.candidates
    state = fold(MAP_SITE, BleScan(T0 + 12.0, (Reading(("z",), -50.0),)), state=state)
    told = explained(state, MAP_SITE, PARAMS)
    assert told is not None
    assert (told.scan_s, told.candidates) == (T0 + 12.0, ())
    assert uses(told) == {"z": Use.UNKNOWN}


@pytest.mark.parametrize("anchors", [ANCHORS, ()], ids=["beacons and map", "map alone"])
@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_explains_what_it_told(profile: str, anchors: tuple[Anchor, ...]) -> None:
    site = SiteModel("s", 1, FLOORS, anchors, MAP_SITE.radio_map)
    params, state = PROFILES[profile].params, start()
    for i in range(4):
        for observation in (
            beacons_at(6.0, 4.0, time_s=T0 + i),
            wifi(T0 + i + 0.5, w0=-55.0, w1=-58.0, w2=-70.0),
            Steps(T0 + i + 0.7, 1, heading_rad=0.0),
        ):
            state, _ = advance(state, observation, site, params)
            explanation = explained(state, site, params)
            assert explanation is not None
            assert explanation.output == finish(state, site, params)[-1]
            told = isinstance(explanation.output, TrackPoint)
            assert (explanation.means is not None) == told
            kinds = {one.kind for one in explanation.transmitters if one.use is Use.USED}
            assert bool(kinds) == told
            weight = sum(one.weight for one in explanation.candidates)
            # Ranges go into blunavi2020's filter one by one: they are no place.
            by_ranges = profile == "blunavi2020" and "wifi" not in kinds
            assert weight == pytest.approx(1.0 if told and not by_ranges else 0.0)
            if told and not by_ranges:
                assert any(vote.vote_share for vote in explanation.floors)
            predicts = profile not in {"grinyak2018", "tao2016"} and not by_ranges
            if told and explanation.scan_s > T0 + 1.0:
                assert (explanation.gate is not None) == predicts
            for one in explanation.transmitters:
                if one.residual_db is not None and one.expected_dbm is not None:
                    assert one.residual_db == one.heard_dbm - one.expected_dbm


def _block(swing_mps2: float) -> ImuBlock:
    acc = np.zeros((100, 3), np.float32)
    acc[:, 2] = 9.81 + swing_mps2 * np.sin(np.arange(100.0))
    none = np.empty((0, 3), np.float32)
    return ImuBlock(T0, 50.0, acc, none, none, np.empty((0, 4), np.float32))


@pytest.mark.parametrize(
    ("observations", "mode", "decided_by"),
    [
        ([wifi(w0=-50.0)], MotionMode.STILL, MotionEvidence.NONE),
        ([Steps(T0, 1)], MotionMode.WALKING, MotionEvidence.STEPS),
        ([Steps(T0, 1), wifi(T0 + 5.0)], MotionMode.STILL, MotionEvidence.STEPS),
        ([_block(0.1)], MotionMode.STILL, MotionEvidence.ACCELERATION),
        ([_block(0.0), Steps(T0 + 1.9, 1)], MotionMode.STILL, MotionEvidence.ACCELERATION),
    ],
)
def test_the_motion_mode_says_what_decided_it(observations, mode, decided_by) -> None:
    motion = why(MAP_SITE, *observations).motion
    assert (motion.mode, motion.decided_by) == (mode, decided_by)
    stepped = any(isinstance(one, Steps) for one in observations)
    assert (motion.since_step_s is not None) == stepped
    inertial = any(isinstance(one, ImuBlock) for one in observations)
    assert (motion.acc_variance_m2ps4 is not None) == inertial


def test_levels_alone_may_decide_the_motion_mode() -> None:
    walk = [beacons_at(4.0 + 0.3 * i, 4.0, time_s=T0 + 0.2 * i) for i in range(25)]
    motion = why(BEACON_SITE, *walk).motion
    assert motion.decided_by is MotionEvidence.LEVELS
    assert motion.velocity_chi2 is not None


FINITE = st.floats(-30.0, 30.0)
VARIANCE = st.floats(0.5, 40.0)


@given(
    places=st.lists(st.tuples(FINITE, FINITE), min_size=1, max_size=5),
    at=st.lists(st.tuples(FINITE, FINITE), min_size=2, max_size=6),
    noise=VARIANCE,
)
def test_the_explained_innovation_is_what_the_filter_did(places, at, noise) -> None:
    params = FusionParams(birth_share=0.0, tempering=1.0)
    state = np.array([[*place, 0.0, 1.0] for place in at])
    before = Particles(state, np.zeros(len(at)), 0)
    weight = np.full(len(places), 1.0 / len(places))
    sighting = Sighting(T0, np.array(places), weight, (noise, 0.0, noise), np.ones(1))
    seen = innovation_of_particles(before, sighting, params)
    assert seen.seen_weight.sum() == pytest.approx(1.0)
    z = seen.seen_weight @ sighting.places
    assert seen.distance_m == pytest.approx(math.dist(z, state[:, :2].mean(axis=0)), abs=1e-6)
    far = [[math.dist(c, x) ** 2 / (2.0 * noise) for c in places] for x in at]
    of_all = [sum(math.exp(-f) for f in row) / len(row) / (2.0 * math.pi * noise) for row in far]
    believed = [one / (one + params.clutter) for one in of_all]
    assert seen.inlier_probability == pytest.approx(sum(believed) / len(at), rel=1e-6, abs=1e-12)
    after = update(before, sighting, ground(None, (1.0, 0.0)), params)
    if np.array_equal(after.state, before.state):  # nothing was resampled
        loud = np.log(np.array(of_all) + params.clutter)
        # What lies beyond `NEGLIGIBLE` is passed over there.
        assert after.log_weight == pytest.approx(loud - loud.max(), abs=1e-4)


def test_a_plain_kalman_filter_takes_all_of_its_sighting() -> None:
    track = PlanarTrack(np.array([1.0, 2.0, 0.5, 0.0]), np.diag([3.0, 1.0, 1.0, 1.0]))
    places, weight = np.array([[4.0, 2.0], [4.0, 6.0]]), np.array([0.5, 0.5])
    sighting = Sighting(T0, places, weight, (6.0, 0.0, 3.0), np.ones(1))
    seen = innovation_of_planar(track, sighting)
    assert seen.nis == pytest.approx(3.0**2 / 9.0 + 2.0**2 / 4.0)
    assert seen.inlier_probability is None
    assert seen.seen_weight.tolist() == [0.5, 0.5]


def test_the_state_of_a_planar_track_explains_itself() -> None:
    state = fold(MAP_SITE, wifi(w0=-50.0, w1=-58.0, w2=-70.0))
    track = PlanarTrack(np.array([4.0, 5.0]), np.diag([4.0, 4.0]))
    assert state.told is not None
    told = replace(state.told, before=track, after=track)
    explanation = explained(replace(state, track=track, told=told), MAP_SITE, PARAMS)
    assert explanation is not None
    assert explanation.gate is not None
    assert explanation.gate.inlier_probability is None
    assert [c.weight for c in explanation.candidates] == [
        c.seen_weight for c in explanation.candidates
    ]
    by_key = {one.key: one for one in explanation.transmitters}
    at_row = math.exp(-0.5 * 16.0 / 9.0)
    expected_dbm = (-50.0 - 60.0 * at_row) / (1.0 + at_row)
    assert by_key["w0"].expected_dbm == pytest.approx(expected_dbm)
