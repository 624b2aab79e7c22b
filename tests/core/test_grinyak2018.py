"""The profile grinyak2018: the solution of the window is the answer, and nothing else is."""

import numpy as np
import pytest
from lateration_room import CORNERS, WALL_MIDDLES, anchors_at

from app.core.engine import advance, finish, start
from app.core.engine.profiles import PROFILES
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.lateration.windowed import Estimate, estimate
from app.core.radio.path_loss import expected_levels, level_model
from app.core.radio.windows import window_of
from app.core.site import Floor, SiteModel
from app.core.types import (
    BleScan,
    Method,
    MotionMode,
    NoFix,
    NoFixReason,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

PARAMS = PROFILES["grinyak2018"].params
T0, PERIOD_S = 1_700_000_000.0, 0.1
FLOOR = Floor("f", "Ground", "b", 0, 0.0, 0.0, 10.0, 10.0)
ANCHORS = anchors_at(CORNERS + WALL_MIDDLES)
ROOM = SiteModel("s", 1, (FLOOR,), ANCHORS)
EAST_MPS = np.array([1.2, 0.0])


def scans_of(place_at, seconds, *, rng, first_s=T0) -> list[BleScan]:
    """One scan a second, every anchor heard ten times in it."""
    ages_s = np.arange(10)[::-1] * PERIOD_S
    scans = []
    for second in range(1, seconds + 1):
        readings = []
        for age_s in ages_s:
            x, y = place_at(second - age_s)
            levels = expected_levels(level_model(ANCHORS), np.array([x]), np.array([y]))[0]
            levels += rng.normal(0.0, 5.0, len(levels))
            readings += [
                Reading(anchor.keys, float(level), float(age_s))
                for anchor, level in zip(ANCHORS, levels, strict=True)
            ]
        scans.append(BleScan(first_s + second, tuple(readings)))
    return scans


def at_rest(_):
    return 4.0, 6.0


def walking_east(since_s):
    return 1.0 + 1.2 * since_s, 5.0


def steps_until(end_s) -> list[Steps]:
    return [Steps(T0 + 0.5 * (i + 1), 1, 0.6, 0.0) for i in range(int(2 * end_s))]


def fold(observations, site=ROOM):
    state = start()
    for observation in sorted(observations, key=lambda o: o.time_s):
        state, _ = advance(state, observation, site, PARAMS)
    return state


def last_point(observations, site=ROOM) -> TrackPoint:
    point = finish(fold(observations, site), site, PARAMS)[-1]
    assert isinstance(point, TrackPoint)
    return point


def window_solution(scans, *, kinematic) -> Estimate:
    """The least-squares solution of the last two scans, which are the window of 2 s."""
    rows = [
        (ANCHORS.index(anchor), scan.time_s - r.age_s, r.rssi_dbm)
        for scan in scans[-2:]
        for r in scan.readings
        for anchor in ANCHORS
        if anchor.keys == r.keys
    ]
    window = window_of(*(np.array(column) for column in zip(*rows, strict=True)))
    found = estimate(
        window,
        level_model(ANCHORS),
        scans[-1].time_s,
        kinematic=kinematic,
        params=PARAMS.lateration,
    )
    assert isinstance(found, Estimate)
    return found


def same_place(point, found) -> None:
    assert (point.x_m, point.y_m) == (found.fix.x_m, found.fix.y_m)
    assert point.covariance_m2 == found.fix.covariance_m2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_at_rest_the_answer_is_the_static_solution_with_its_d(seed):
    scans = scans_of(at_rest, 4, rng=np.random.default_rng(seed))
    point = last_point(scans)
    same_place(point, window_solution(scans, kinematic=False))
    assert (point.method, point.motion) == (Method.LATERATION, MotionMode.STILL)
    assert point.profile == "grinyak2018"


def test_with_steps_the_answer_is_the_kinematic_solution_with_its_velocity():
    scans = scans_of(walking_east, 6, rng=np.random.default_rng(4))
    found = window_solution(scans, kinematic=True)
    state = fold([*scans, *steps_until(6.0)])
    point = finish(state, ROOM, PARAMS)[-1]
    same_place(point, found)
    assert point.motion is MotionMode.WALKING
    assert point.speed_mps == pytest.approx(np.hypot(*found.fix.velocity_mps))
    np.testing.assert_array_equal(state.track.covariance, found.covariance)
    assert state.track.covariance.shape == (4, 4)


def test_there_is_no_filter():
    rng = np.random.default_rng(5)
    elsewhere = scans_of(lambda _: (9.0, 1.0), 6, rng=rng)
    here = scans_of(at_rest, 3, rng=rng, first_s=T0 + 6.0)
    same_place(last_point([*elsewhere, *here]), window_solution(here, kinematic=False))
    assert last_point([*elsewhere, *here]).x_m == last_point(here).x_m


def test_steps_move_nothing():
    scans = scans_of(at_rest, 3, rng=np.random.default_rng(6))
    stepping = [*scans, Steps(T0 + 3.2, 1, 0.7, 0.0), Steps(T0 + 3.8, 1, 0.7, 0.0)]
    still, moved = last_point(scans), last_point(stepping)
    assert (still.x_m, still.y_m) == (moved.x_m, moved.y_m)
    assert moved.motion is MotionMode.WALKING


def test_a_solution_stands_for_seconds_and_no_longer():
    scans = scans_of(at_rest, 3, rng=np.random.default_rng(7))
    soon, late = (BleScan(scans[-1].time_s + gap_s, ()) for gap_s in (4.0, 6.0))
    assert last_point([*scans, soon]).age_s == 4.0
    output = finish(fold([*scans, late]), ROOM, PARAMS)[-1]
    assert output == NoFix(late.time_s, NoFixReason.NOTHING_HEARD)


def wifi() -> WifiScan:
    return WifiScan(T0, (Reading(("mac:aa0000000000",), -50.0),))


def surveyed(anchors=()) -> SiteModel:
    rows = [Fingerprint(0, 1.0, 1.0, {"mac:aa0000000000": -50.0}, {ANCHORS[0].keys[0]: -60.0})]
    return SiteModel("s", 1, (FLOOR,), anchors, build_radio_map(("f",), rows))


@pytest.mark.parametrize(
    ("observation", "site", "reason"),
    [
        (wifi(), surveyed(), NoFixReason.NO_BEACONS),
        (BleScan(T0, (Reading(ANCHORS[0].keys, -60.0),)), surveyed(), NoFixReason.NO_BEACONS),
        (BleScan(T0, ()), SiteModel("s", 1, (FLOOR,)), NoFixReason.NO_BEACONS),
        (wifi(), ROOM, NoFixReason.NOTHING_HEARD),
        (BleScan(T0, ()), surveyed(ANCHORS), NoFixReason.NOTHING_HEARD),
        (
            BleScan(T0, (Reading(("mac:bb0000000000",), -60.0),)),
            surveyed(ANCHORS),
            NoFixReason.UNKNOWN_TRANSMITTERS,
        ),
        (
            BleScan(T0, tuple(Reading(a.keys, -60.0) for a in ANCHORS[:2])),
            ROOM,
            NoFixReason.TOO_FEW_TRANSMITTERS,
        ),
    ],
)
def test_no_fix_says_why(observation, site, reason):
    assert finish(fold([observation], site), site, PARAMS) == (NoFix(T0, reason),)


def test_wifi_hides_no_reason_that_beacons_gave():
    few = BleScan(T0, tuple(Reading(a.keys, -60.0) for a in ANCHORS[:2]))
    state = fold([few, WifiScan(T0 + 1.0, wifi().readings)])
    assert finish(state, ROOM, PARAMS)[-1].reason is NoFixReason.TOO_FEW_TRANSMITTERS


def test_parameters_are_the_papers():
    lateration = PARAMS.lateration
    assert lateration.window_s == 2.0
    assert (lateration.offset_prior_db, lateration.velocity_prior_mps) == (0.0, None)
    assert lateration.shadowing_correlation == 0.0
