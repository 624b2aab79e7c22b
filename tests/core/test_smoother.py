"""Smoothing of whole tracks: filterpy agrees where it can speak, and walks get better by it."""

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from wifi_hall import PACE_MPS, START_S, STEP_S, hall, walked

from app.core.engine import advance, finish, in_order, smoothed, start
from app.core.fusion.sighting import Sighting
from app.core.fusion.smoother import Leg, Path, smooth
from app.core.geometry import Walkable
from app.core.params import Params
from app.core.simulate import walk, warehouse
from app.core.types import Method, Pedometer, Steps, TrackPoint, WifiScan

PARAMS = Params()
PLAIN = dataclasses.replace(PARAMS.smoother, noise_ratio=1.0, passes=8)
ONCE = dataclasses.replace(PLAIN, passes=1)
T0 = 1_700_000_000.0
NONE = np.empty(0)


def sighted(time_s, place, noise=(9.0, 2.0, 12.0), drift_m2=1.5):
    one = Sighting(time_s, np.array([place]), np.ones(1), noise, np.ones(1))
    return Leg(time_s, NONE, NONE, drift_m2, one, None)


def guess(legs, place=(0.0, 0.0)):
    return Path(np.tile(np.asarray(place), (len(legs), 1)), np.tile(np.eye(2), (len(legs), 1, 1)))


def test_a_random_walk_is_smoothed_as_filterpy_does():
    places = np.random.default_rng(1).normal(0.0, 5.0, (20, 2)).cumsum(axis=0)
    legs = [sighted(float(i), place) for i, place in enumerate(places)]
    path = smooth(legs, guess(legs), ONCE)
    oracle = KalmanFilter(dim_x=2, dim_z=2)
    oracle.x, oracle.P = np.zeros(2), np.eye(2) * ONCE.start_m**2
    oracle.F, oracle.H, oracle.Q = np.eye(2), np.eye(2), np.eye(2) * 1.5
    oracle.R = np.array([[9.0, 2.0], [2.0, 12.0]])
    means, covariances, _, _ = oracle.batch_filter(list(places))
    mean, covariance, _, _ = oracle.rts_smoother(means, covariances)
    np.testing.assert_allclose(path.place, mean, atol=1e-8)
    np.testing.assert_allclose(path.covariance, covariance, atol=1e-8)


def test_strides_between_two_sightings_tell_heading_and_length():
    stride = (np.full(10, 0.7), np.full(10, 0.3))
    tight = (0.05, 0.0, 0.05)
    legs = [
        sighted(0.0, (0.0, 0.0), tight, 0.0),
        Leg(5.0, *stride, 0.0, None, None),
        sighted(10.0, (0.0, 16.0), tight, 0.0),
    ]
    legs[2] = dataclasses.replace(legs[2], length_m=stride[0], heading_rad=stride[1])
    path = smooth(legs, guess(legs), ONCE)
    assert path.place[0] == pytest.approx([0.0, 0.0], abs=1.0)
    assert path.place[1] == pytest.approx([0.0, 8.0], abs=2.0)
    assert path.place[2] == pytest.approx([0.0, 16.0], abs=1.0)


def test_a_path_off_the_floor_is_drawn_to_it():
    y = 0.5 * np.arange(-20, 21)
    corridor = Walkable(-10.0, -10.0, 0.5, np.tile(np.maximum(np.abs(y) - 1.0, 0.0)[:, None], 41))
    legs = [
        dataclasses.replace(sighted(float(i), (i - 5.0, 4.0)), walkable=corridor) for i in range(10)
    ]
    free = smooth(legs, guess(legs), ONCE)
    drawn = smooth(legs, guess(legs), PLAIN)
    assert np.abs(free.place[:, 1]).min() > 3.0
    assert np.abs(drawn.place[:, 1]).mean() < np.abs(free.place[:, 1]).mean() - 1.0
    np.testing.assert_allclose(drawn.place[:, 0], free.place[:, 0], atol=0.3)


@pytest.fixture(scope="module")
def world():
    return warehouse(5)


def errors(points, walked):
    return np.array(
        [
            np.hypot(p.x_m - walked.truth_at(p.time_s).x_m, p.y_m - walked.truth_at(p.time_s).y_m)
            for p in points
        ]
    )


def test_smoothed_walks_are_nearer_to_the_truth(world):
    causal, final = [], []
    for seed in range(3):
        walked = walk(world, seed, start_s=T0, duration_s=90.0)
        state, outputs = start(), []
        for observation in walked.observations:
            state, new = advance(state, observation, world.site, PARAMS)
            outputs.extend(new)
        outputs.extend(finish(state, world.site, PARAMS))
        points = [o for o in outputs if isinstance(o, TrackPoint)]
        track = smoothed(walked.observations, world.site, PARAMS)
        assert [p.time_s for p in track] == [p.time_s for p in points]
        assert smoothed(walked.observations, world.site, PARAMS) == track
        causal.append(errors(points, walked))
        final.append(errors(track, walked))
    assert np.concatenate(final).mean() < 0.9 * np.concatenate(causal).mean()


@pytest.mark.parametrize(("deaf_s", "told_s"), [(6.0, 6.0), (25.0, PARAMS.report.fused_s)])
def test_a_stored_track_begins_before_the_first_fix(world, deaf_s, told_s):
    walked = walk(world, 2, start_s=T0, duration_s=60.0)
    late = [o for o in walked.observations if not hasattr(o, "readings") or o.time_s >= T0 + deaf_s]
    track = smoothed(late, world.site, PARAMS)
    first = next(p for p in track if p.method is not Method.DEAD_RECKONING)
    before = [p for p in track if p.time_s < first.time_s]
    assert first.time_s - before[0].time_s == pytest.approx(told_s, abs=1.0)
    assert errors(before, walked).max() < 6.0
    assert all(p.age_s == first.time_s - p.time_s for p in before)
    radii = [p.radius95_m for p in (*before, first)]
    assert radii == sorted(radii, reverse=True)


def test_an_even_walk_has_even_seconds():
    # Strides end at 0.55 s intervals: a second holds one or two whole ones.
    ahead = walked([(2.0, 20.0), (38.0, 20.0)], np.random.default_rng(1), 28.0)
    seconds = smoothed(ahead, hall(), PARAMS)[2:-1]
    assert np.diff([p.x_m for p in seconds]) == pytest.approx(PACE_MPS, rel=0.25)


def test_who_takes_a_stride_after_a_rest_stood_until_then():
    began_s, over_s = START_S + 10.0, START_S + 20.0
    told = walked([(2.0, 20.0), (38.0, 20.0)], np.random.default_rng(1), 28.0)
    rested = [one for one in told if not began_s < one.time_s < over_s]
    stood = [p for p in smoothed(rested, hall(), PARAMS) if began_s < p.time_s < over_s - 1.0]
    assert len(stood) > 5
    assert {(p.x_m, p.y_m) for p in stood} == {(stood[0].x_m, stood[0].y_m)}


def test_strides_that_a_pedometer_tells_late_lie_between_the_scans_they_were_taken_between():
    told = walked([(2.0, 20.0), (38.0, 20.0)], np.random.default_rng(1), 28.0)
    scans = [one for one in told if isinstance(one, WifiScan)]
    length_m, each_s = PACE_MPS * STEP_S, 11 * STEP_S
    at_once = [Steps(START_S + i * STEP_S, 1, length_m) for i in range(45)]
    late = [
        Pedometer(START_S + i * each_s, START_S + (i + 1) * each_s, 11, 11 * length_m)
        for i in range(4)
    ]
    there, here = (
        [(p.x_m, p.y_m) for p in smoothed(in_order([*scans, *steps]), hall(), PARAMS)]
        for steps in (at_once, [at_once[0], *late])
    )
    np.testing.assert_allclose(here, there, atol=0.01)


def off_by(scan, rng, sigma_db):
    readings = [
        dataclasses.replace(one, rssi_dbm=one.rssi_dbm + rng.normal(0.0, sigma_db))
        for one in scan.readings
    ]
    return dataclasses.replace(scan, readings=tuple(readings))


def test_a_stored_track_is_less_sure_where_the_map_hardly_knew_what_was_heard():
    rng = np.random.default_rng(1)
    middle_s = START_S + 14.0
    heard = [
        off_by(o, rng, 12.0) if isinstance(o, WifiScan) and o.time_s > middle_s else o
        for o in walked([(2.0, 20.0), (38.0, 20.0)], rng, 28.0)
    ]
    track = smoothed(heard, hall(), PARAMS)
    known, hardly = (
        np.mean([p.radius95_m for p in track if (p.time_s > middle_s) is late])
        for late in (False, True)
    )
    assert hardly > 1.2 * known


def test_a_stored_track_among_beacons_claims_no_less_than_it_knows(world):
    among = dataclasses.replace(world.site, radio_map=None)
    known, causal = [], []
    for seed in range(3):
        walked = walk(world, seed, start_s=T0, duration_s=60.0)
        track = smoothed(walked.observations, among, PARAMS)
        radii_m = np.array([p.radius95_m for p in track])
        assert np.mean(errors(track, walked) <= radii_m) > 0.95
        known += radii_m.tolist()
        state = start()
        for observation in walked.observations:
            state, outputs = advance(state, observation, among, PARAMS)
            causal += [p.radius95_m for p in outputs if isinstance(p, TrackPoint)]
    assert np.mean(known) < 1.5 * np.mean(causal)


def test_a_session_without_any_fix_has_no_track(world):
    walked = walk(world, 1, start_s=T0, duration_s=20.0)
    deaf = [o for o in walked.observations if not hasattr(o, "readings")]
    assert smoothed(deaf, world.site, PARAMS) == ()
    assert smoothed([], world.site, PARAMS) == ()
