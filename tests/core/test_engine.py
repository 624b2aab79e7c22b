"""The fold: whole seconds, causality, determinism, and reasons where there is no position."""

import dataclasses
import math

import numpy as np
import pytest

from app.core.changed import changed
from app.core.engine import PROFILES, advance, finish, in_order, order_key, start
from app.core.engine.order import Content
from app.core.engine.report import radius95_m
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.params import Params
from app.core.session import event_time_s
from app.core.simulate import walk, warehouse
from app.core.site import Floor, SiteModel
from app.core.types import (
    BleScan,
    ImuBlock,
    Method,
    NoFix,
    NoFixReason,
    Pedometer,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

PARAMS = Params()
T0 = 1_700_000_000.0


@pytest.fixture(scope="module")
def world():
    return warehouse(3)


@pytest.fixture(scope="module", params=[False, True], ids=["phone steps", "imu"])
def observations(world, request):
    return walk(world, 11, start_s=T0, duration_s=40.0, imu=request.param).observations


def fold(observations, site, state=None):
    state, outputs = state or start(), []
    for observation in observations:
        state, new = advance(state, observation, site, PARAMS)
        outputs.extend(new)
    return state, outputs


def test_one_output_for_every_whole_second(world, observations):
    state, outputs = fold(observations, world.site)
    ended = (*outputs, *finish(state, world.site, PARAMS))
    times = [o.time_s for o in ended]
    first = math.ceil(observations[0].time_s)
    latest = max(event_time_s(o) for o in observations)
    assert times[:-1] == [first + i for i in range(len(times) - 1)]
    assert times[-1] == latest
    assert latest - times[-2] <= 1.0


def test_the_past_does_not_know_the_future(world, observations):
    _, whole = fold(observations, world.site)
    middle = T0 + 20.0
    # An inertial block belongs to its first sample: what it says of later samples waits.
    _, half = fold([o for o in observations if o.time_s <= middle], world.site)
    assert half
    for early, late in zip(half, whole, strict=False):
        assert early == late


def test_an_older_state_is_a_checkpoint(world, observations):
    cut = len(observations) // 2
    state, head = fold(observations[:cut], world.site)
    _, tail = fold(observations[cut:], world.site, state)
    _, again = fold(observations[cut:], world.site, state)
    _, whole = fold(observations, world.site)
    assert tail == again
    assert head + tail == whole


def test_the_end_of_a_track_does_not_touch_the_fold(world, observations):
    cut = len(observations) // 2
    state, _ = fold(observations[:cut], world.site)
    before = fold(observations[cut:], world.site, state)[1]
    finish(state, world.site, PARAMS)
    assert fold(observations[cut:], world.site, state)[1] == before


def test_equal_keys_are_equal_observations(observations):
    keys = [order_key(o) for o in observations]
    assert len(set(keys)) == len(keys)
    assert keys == sorted(keys)
    copies = [dataclasses.replace(o) for o in observations]
    assert [order_key(o) for o in copies] == keys


def test_content_decides_among_observations_of_one_time_and_kind():
    scans = [WifiScan(1.0, (Reading((f"k{i}",), -60.0),)) for i in range(8)]
    ordered = in_order(scans)
    assert in_order([*reversed(scans), *map(dataclasses.replace, scans)]) == ordered
    digests = [order_key(scan)[2].digest for scan in ordered]
    assert digests == sorted(set(digests))
    # A key that was stored holds the digest alone.
    assert [(1.0, order_key(scans[0])[1], Content(d)) for d in digests] == list(
        map(order_key, ordered)
    )


def test_fixes_and_steps_are_fused(world, observations):
    points = [o for o in fold(observations, world.site)[1] if isinstance(o, TrackPoint)]
    assert len(points) > 25
    assert {p.method for p in points} >= {Method.FUSED}
    assert any(p.used.beacons > 3 for p in points)
    assert any(p.speed_mps > 0.5 and p.heading_rad is not None for p in points)
    for point in points:
        xx, xy, yy = point.covariance_m2
        assert xx * yy > xy * xy
        assert point.radius95_m == pytest.approx(radius95_m(xx, xy, yy))


def scan_of(levels, time_s=T0, age_s=0.1):
    return WifiScan(time_s, tuple(Reading((k,), v, age_s) for k, v in levels.items()))


@pytest.fixture(scope="module")
def small_site():
    rows = [
        Fingerprint(
            0,
            float(x),
            0.0,
            {f"mac:{i:012x}": -40.0 - 2.0 * abs(x - 4 * i) for i in range(6)},
            {f"mac:b{i:011x}": -50.0 - 2.0 * abs(x - 4 * i) for i in range(6)},
        )
        for x in range(20)
    ]
    floor = Floor("f0", "Ground", "b", 0, 0.0, 0.0, 20.0, 10.0)
    return SiteModel("s", 1, (floor,), radio_map=build_radio_map(("f0",), rows))


HEARD = {"mac:000000000000": -40.0, "mac:000000000001": -48.0, "mac:000000000002": -56.0}


@pytest.mark.parametrize(
    ("scan", "reason"),
    [
        (scan_of({}), NoFixReason.NOTHING_HEARD),
        (scan_of(dict(list(HEARD.items())[:2])), NoFixReason.TOO_FEW_TRANSMITTERS),
        (scan_of(HEARD, age_s=60.0), NoFixReason.READINGS_TOO_OLD),
        (scan_of({f"mac:f{i:011x}": -50.0 for i in range(5)}), NoFixReason.UNKNOWN_TRANSMITTERS),
        (
            scan_of({f"mac:f{i:011x}": -30.0 for i in range(60)} | {"mac:000000000001": -98.0}),
            NoFixReason.OUTSIDE_MAPPED_AREA,
        ),
    ],
)
def test_no_position_has_a_reason(scan, reason, small_site):
    state, _ = fold([scan], small_site)
    assert finish(state, small_site, PARAMS) == (NoFix(scan.time_s, reason),)


def test_a_phone_that_has_left_is_told_what_its_last_scans_say(small_site):
    elsewhere = {f"mac:f{i:011x}": -50.0 for i in range(5)}
    age_s = PARAMS.report.max_age_s
    away = [scan_of(elsewhere, time_s=T0 + s) for s in np.arange(10.0, age_s + 20.0, 10.0)]
    state, outputs = fold([scan_of(HEARD), *away], small_site)
    assert isinstance(outputs[0], TrackPoint)
    assert finish(state, small_site, PARAMS)[-1].reason is NoFixReason.UNKNOWN_TRANSMITTERS


@pytest.mark.parametrize("profile", ["best", "liu2016"])
def test_a_phone_that_went_silent_is_not_told_what_it_heard_before(profile, small_site):
    params, state = PROFILES[profile].params, start()
    strangers = scan_of({f"mac:f{i:011x}": -50.0 for i in range(5)}, time_s=T0 - 1.0)
    late_s = T0 + params.report.max_age_s + 10.0
    # liu2016 passes over beacons, and has nothing to say of them.
    for last in (strangers, scan_of(HEARD), Steps(late_s, 1), BleScan(late_s, ())):
        state, _ = advance(state, last, small_site, params)
    assert state.told_s == T0
    reason = finish(state, small_site, params)[-1].reason
    assert reason is NoFixReason.NOTHING_HEARD


def test_a_site_without_map_and_beacons_says_so(small_site):
    bare = dataclasses.replace(small_site, radio_map=None)
    for scan in (scan_of(HEARD), BleScan(T0, (Reading(("mac:b00000000001",), -50.0),))):
        state, _ = fold([scan], bare)
        reason = finish(state, bare, PARAMS)[-1].reason
        assert reason is NoFixReason.NO_RADIO_MAP_OR_BEACONS


def test_a_phone_without_wifi_is_placed_by_beacons_after_a_while(small_site):
    readings = tuple(Reading((f"mac:b{i:011x}",), -50.0 - 8.0 * i) for i in range(3))
    scans = [BleScan(T0 + i, readings) for i in range(15)]
    _, outputs = fold(scans, small_site)
    placed = [o.time_s for o in outputs if isinstance(o, TrackPoint)]
    assert placed
    assert placed[0] - T0 >= PARAMS.match.wifi_start_s
    assert abs(outputs[-1].x_m) < 3.0


def swinging(second):
    """Return a second of a walker who takes two steps in it; his phone points north."""
    acc = np.zeros((50, 3), dtype=np.float32)
    acc[:, 2] = 9.81 + 3.0 * np.sin(4 * np.pi * (second + np.arange(50) / 50))
    empty = np.empty((0, 3), dtype=np.float32)
    quat = np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (50, 1))
    return ImuBlock(T0 + second, 50.0, acc, empty, empty, quat)


def test_the_phones_own_steps_are_believed_before_ours(small_site):
    own = [scan_of(HEARD), *(swinging(s) for s in range(8))]
    told = [o for s in range(8) for o in (swinging(s), Steps(T0 + s + 0.5, 1, 0.7, 0.0))]
    walked_own = fold(own, small_site)[1][-1]
    walked_told = fold([scan_of(HEARD), *told], small_site)[1][-1]
    assert walked_own.used.steps >= 8
    assert walked_told.used.steps == 7
    assert walked_own.y_m > 4.0  # the rotation vector points north
    assert walked_told.x_m - walked_told.y_m > 2.5  # the phone said east


def test_an_interval_of_a_pedometer_is_walked_at_its_end(small_site):
    head = [scan_of(HEARD), BleScan(T0 + 9.9, ())]
    before, _ = fold(head, small_site)
    after, _ = fold([Pedometer(T0, T0 + 10.0, 14, 9.8)], small_site, before)
    (point,) = finish(after, small_site, PARAMS)
    assert (point.time_s, point.used.steps, point.motion) == (T0 + 10.0, 14, "walking")
    spread = [s.time_s - T0 for s in after.evidence.strides]
    assert spread == pytest.approx([10.0 * (i + 1) / 14 for i in range(14)])
    assert spread[-1] == 10.0
    assert [s.length_m for s in after.evidence.strides] == pytest.approx([0.7] * 14)
    assert not after.pending


def test_a_pedometer_counts_no_stride_that_was_found_already(small_site):
    blocks = [swinging(second) for second in range(10)]
    interval = Pedometer(T0, T0 + 9.99, 20, 14.0)
    told = fold([scan_of(HEARD), *blocks, interval], small_site)[0]
    assert 18 <= told.used.steps <= 21
    assert all(math.isfinite(s.heading_rad) for s in told.evidence.strides)
    again = fold([swinging(10), Pedometer(T0 + 9.99, T0 + 12.0, 4)], small_site, told)[0]
    assert again.used.steps == told.used.steps + 4


def test_after_the_phones_last_word_reports_stop(small_site):
    later = T0 + 3600.0
    _, outputs = fold([scan_of(HEARD), scan_of(HEARD, later)], small_site)
    times = [o.time_s for o in outputs]
    assert times[-1] - T0 <= PARAMS.report.silence_s
    assert len(times) == PARAMS.report.silence_s


def test_a_place_told_long_ago_is_no_place(small_site):
    still = [BleScan(T0 + s, ()) for s in range(1, 90)]
    _, outputs = fold([scan_of(HEARD), *still], small_site)
    assert isinstance(outputs[30], TrackPoint)
    assert isinstance(outputs[-1], NoFix)


def test_a_place_told_by_a_scan_that_the_map_hardly_knows_is_less_sure(small_site):
    state, _ = fold([scan_of(HEARD)], small_site)
    hardly = changed(state, sighted_m2=state.sighted_m2 + 100.0)
    (known,), (unknown,) = (finish(s, small_site, PARAMS) for s in (state, hardly))
    more_m2 = np.subtract(unknown.covariance_m2, known.covariance_m2)
    assert more_m2 == pytest.approx(PARAMS.report.sighted_share * np.array([100.0, 0.0, 100.0]))
    assert unknown.radius95_m > known.radius95_m


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.7, 1.0])
def test_the_radius_holds_95_of_100(ratio):
    rng = np.random.default_rng(8)
    draws = rng.normal(0.0, 1.0, (200_000, 2)) * [3.0, 3.0 * ratio]
    radius = radius95_m(9.0, 0.0, 9.0 * ratio**2)
    assert np.mean(np.hypot(*draws.T) <= radius) == pytest.approx(0.95, abs=0.003)
    turned = radius95_m(
        9.0 * (1 + ratio**2) / 2, 9.0 * (1 - ratio**2) / 2, 9.0 * (1 + ratio**2) / 2
    )
    assert turned == pytest.approx(radius)
