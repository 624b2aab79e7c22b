"""blunavi2020: ranges where beacons are in sight, votes elsewhere, steps between."""

import numpy as np
import pytest

from app.core.engine import PROFILES, advance, finish, start
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fusion.planar import PlanarTrack
from app.core.radio.path_loss import expected_levels, level_model
from app.core.site import Floor, SiteModel
from app.core.types import (
    Anchor,
    BleScan,
    Method,
    NoFix,
    NoFixReason,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

PARAMS = PROFILES["blunavi2020"].params
FLOORS = (
    Floor("ground", "Ground", "b", 0, 0.0, 0.0, 40.0, 10.0),
    Floor("upper", "Upper", "b", 1, 0.0, 0.0, 40.0, 10.0),
)
ANCHORS = tuple(
    Anchor(f"a{i}", (f"mac:b{i}",), "ground", x, y, shadowing_db=4.0)
    for i, (x, y) in enumerate([(0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0)])
)
MODEL = level_model(ANCHORS)


def mapped(x, floor=0, beacons=None):
    """Return a survey scan at (x, 5): the levels of four access points of its floor."""
    wifi = {f"mac:w{floor}{i}": -40.0 - 1.2 * abs(x - 10.0 * i) for i in range(5)}
    return Fingerprint(floor, x, 5.0, wifi, beacons or {}, "walk")


MAP = build_radio_map(
    ("ground", "upper"),
    [
        mapped(x, floor, {f"mac:c{i}": -50.0 - 1.2 * abs(x - 15.0 * i) for i in range(3)})
        for floor in (0, 1)
        for x in np.arange(1.5, 40.0, 3.0)
    ],
)
BOTH = SiteModel("s", 1, FLOORS, ANCHORS, MAP)
RANGES_ONLY = SiteModel("s", 1, FLOORS, ANCHORS)
VOTES_ONLY = SiteModel("s", 1, FLOORS, (), MAP)


def wifi_at(time_s, x, floor=0):
    readings = tuple(Reading((k,), v) for k, v in mapped(x, floor).wifi_dbm.items())
    return WifiScan(time_s, readings)


def beacons_at(time_s, x, y, loss_db=0.0, fading_db=1.0, seed=0):
    """Return ten advertisements of each anchor within the second before."""
    rng = np.random.default_rng(seed + int(10 * time_s))
    level = expected_levels(MODEL, np.array([x]), np.array([y]))[0] - loss_db
    readings = [
        Reading((f"mac:b{i}",), level[i] + fading_db * rng.normal(), age_s=n / 10.0)
        for i in range(4)
        for n in range(10)
    ]
    return BleScan(time_s, tuple(readings))


def fold(observations, site, params=PARAMS):
    state = start()
    for observation in observations:
        state, _ = advance(state, observation, site, params)
    return state, finish(state, site, params)[-1]


def place(point):
    assert isinstance(point, TrackPoint), point
    return np.array([point.x_m, point.y_m])


def test_ranges_in_sight_tell_the_place_of_a_site_without_a_map():
    state, point = fold([beacons_at(t, 7.0, 4.0) for t in (1.0, 2.0, 3.0, 4.0)], RANGES_ONLY)
    assert place(point) == pytest.approx([7.0, 4.0], abs=2.0)
    assert point.method is Method.FUSED
    assert point.floor_id == "ground"
    assert point.profile == "blunavi2020"
    assert isinstance(state.track, PlanarTrack)


def test_votes_tell_the_place_where_there_are_no_beacons():
    _, point = fold([wifi_at(1.0, 22.5)], VOTES_ONLY)
    assert place(point) == pytest.approx([22.5, 5.0])
    assert point.method is Method.FINGERPRINT


def test_fingerprints_are_not_asked_while_beacons_are_in_sight():
    seen = [beacons_at(t, 7.0, 4.0) for t in (1.0, 2.0, 3.0)]
    _, without_scan = fold(seen, BOTH)
    # A scan from the other end of the floor, which voting would follow.
    _, point = fold([*seen, wifi_at(3.0, 37.5)], BOTH)
    assert place(point) == pytest.approx(place(without_scan))


def test_hidden_beacons_leave_the_place_to_the_votes():
    hidden = [beacons_at(t, 7.0, 4.0, loss_db=12.0, fading_db=6.0, seed=3) for t in (2.0, 3.0, 4.0)]
    begun = wifi_at(1.0, 7.5)
    _, point = fold([begun, *hidden, wifi_at(4.0, 7.5)], BOTH)
    assert place(point) == pytest.approx([7.5, 5.0], abs=0.1)


def test_steps_carry_the_track_between():
    walked = [Steps(1.0 + 0.5 * i, 1, 0.7, 0.0) for i in range(1, 11)]
    _, before = fold([wifi_at(1.0, 10.5)], VOTES_ONLY)
    _, after = fold([wifi_at(1.0, 10.5), *walked], VOTES_ONLY)
    assert place(after) - place(before) == pytest.approx([7.0, 0.0])
    assert after.radius95_m > before.radius95_m


def test_a_vote_corrects_the_dead_reckoning_and_does_not_replace_it():
    _, point = fold([wifi_at(1.0, 10.5), wifi_at(2.0, 16.5)], VOTES_ONLY)
    assert 11.0 < point.x_m < 16.0
    assert point.method is Method.FUSED


def test_a_vote_for_another_floor_moves_nothing_until_the_floor_is_believed():
    told = [wifi_at(1.0 + i, 10.5) for i in range(3)]
    upstairs = [wifi_at(4.0 + i, 34.5, floor=1) for i in range(8)]
    _, once = fold([*told, upstairs[0]], VOTES_ONLY)
    assert (once.floor_id, once.x_m) == ("ground", pytest.approx(10.5))
    _, often = fold([*told, *upstairs], VOTES_ONLY)
    assert often.floor_id == "upper"
    assert often.x_m > 20.0


def test_an_iphone_votes_with_beacons_alone():
    scans = [
        BleScan(
            float(t),
            tuple(Reading((f"mac:c{i}",), -50.0 - 1.2 * abs(19.5 - 15.0 * i)) for i in range(3)),
        )
        for t in range(1, 20)
    ]
    _, point = fold(scans, VOTES_ONLY)
    assert place(point) == pytest.approx([19.5, 5.0])


@pytest.mark.parametrize(
    ("observation", "site", "reason"),
    [
        (wifi_at(1.0, 5.0), SiteModel("s", 1, FLOORS), NoFixReason.NO_RADIO_MAP_OR_BEACONS),
        (beacons_at(1.0, 5.0, 5.0), SiteModel("s", 1, FLOORS), NoFixReason.NO_RADIO_MAP_OR_BEACONS),
        (WifiScan(1.0, ()), VOTES_ONLY, NoFixReason.NOTHING_HEARD),
        (BleScan(1.0, ()), RANGES_ONLY, NoFixReason.NOTHING_HEARD),
        (
            WifiScan(1.0, tuple(Reading((f"mac:x{i}",), -50.0) for i in range(5))),
            VOTES_ONLY,
            NoFixReason.UNKNOWN_TRANSMITTERS,
        ),
        (
            BleScan(1.0, (Reading(("mac:x",), -50.0),)),
            RANGES_ONLY,
            NoFixReason.UNKNOWN_TRANSMITTERS,
        ),
        (
            WifiScan(1.0, tuple(Reading((f"mac:w0{i}",), -20.0) for i in range(5))),
            VOTES_ONLY,
            NoFixReason.OUTSIDE_MAPPED_AREA,
        ),
        (
            beacons_at(1.0, 7.0, 4.0, fading_db=8.0, seed=1),
            RANGES_ONLY,
            NoFixReason.TOO_FEW_TRANSMITTERS,
        ),
    ],
)
def test_where_there_is_no_place_there_is_its_reason(observation, site, reason):
    _, outcome = fold([observation], site)
    assert outcome == NoFix(observation.time_s, reason)


def test_without_sensors_the_track_widens_with_time():
    quiet = [BleScan(float(t), ()) for t in range(2, 12)]
    early, _ = fold([wifi_at(1.0, 10.5)], VOTES_ONLY)
    late, _ = fold([wifi_at(1.0, 10.5), *quiet], VOTES_ONLY)
    assert np.diag(late.track.covariance - early.track.covariance) == pytest.approx([10.0, 10.0])
