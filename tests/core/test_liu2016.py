"""The profile liu2016: what it makes of scans and steps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from wifi_hall import PACE_MPS, START_S, hall, place_on, scan, walked

from app.core.engine import PROFILES, SessionState, advance, finish, start
from app.core.engine.liu2016 import Liu2016Params
from app.core.fusion.blending import BlendedMotion, BlendingParams
from app.core.types import BleScan, Method, NoFix, NoFixReason, Reading, TrackPoint, WifiScan
from app.storage.codec import TreeCodec

PARAMS = PROFILES["liu2016"].params
SITE = hall()
CORNERS = [(5.0, 5.0), (35.0, 5.0), (35.0, 35.0), (5.0, 35.0)]


def folded(observations, site=SITE, params=PARAMS) -> SessionState:
    state = start()
    for observation in observations:
        state, _ = advance(state, observation, site, params)
    return state


def answered(observations, site=SITE, params=PARAMS) -> TrackPoint | NoFix:
    return finish(folded(observations, site, params), site, params)[-1]


def errors_m(observations, params=PARAMS) -> list[float]:
    """Return the error at every scan."""
    state, errors = start(), []
    for observation in observations:
        state, _ = advance(state, observation, SITE, params)
        if isinstance(observation, WifiScan):
            x, y, _ = place_on(CORNERS, PACE_MPS * (observation.time_s - START_S))
            errors.append(math.hypot(state.track.mean[0] - x, state.track.mean[1] - y))
    return errors


def test_the_first_fix_is_that_of_the_nearest_fingerprints() -> None:
    point = answered([scan(START_S, 12.0, 8.0)])
    assert isinstance(point, TrackPoint)
    assert (point.x_m, point.y_m) == pytest.approx((12.0, 8.0), abs=0.5)
    assert point.method is Method.FINGERPRINT
    assert point.profile == "liu2016"
    assert point.used.access_points > 3


def test_a_walk_is_followed_better_than_its_fixes_tell_it() -> None:
    fused, alone = [], []
    for seed in range(6):
        observations = walked(CORNERS, np.random.default_rng(seed), 70.0)
        fused += errors_m(observations)
        state = start()
        for observation in observations:
            state, _ = advance(state, observation, SITE, PARAMS)
            if isinstance(observation, WifiScan):
                sighting = state.evidence.sighting
                x, y, _ = place_on(CORNERS, PACE_MPS * (observation.time_s - START_S))
                alone.append(math.hypot(*(sighting.weight @ sighting.places - (x, y))))
    assert np.mean(fused) < 0.8 * np.mean(alone)


def test_strides_carry_the_track_between_scans() -> None:
    observations = walked(CORNERS, np.random.default_rng(1), 20.0)
    last_scan = max(i for i, o in enumerate(observations) if isinstance(o, WifiScan))
    before = folded(observations[: last_scan + 1]).track.mean[:2]
    after = folded(observations).track.mean[:2]
    strides = len(observations) - last_scan - 1
    assert strides >= 2
    assert 0.6 < (after[0] - before[0]) / (strides * 0.66) < 1.2


def test_the_blended_speed_and_heading_are_those_of_the_walk() -> None:
    state = folded(walked(CORNERS, np.random.default_rng(2), 24.0))
    motion = state.memory
    assert isinstance(motion, BlendedMotion)
    assert motion.heading_rad == pytest.approx(0.0, abs=0.1)
    # Three or four steps of 0.66 m in 2 s.
    assert motion.speeds[2] == pytest.approx(PACE_MPS, abs=0.25)
    assert state.track.mean[2:] == pytest.approx([PACE_MPS, 0.0], abs=0.4)


def test_the_weights_are_what_it_blends_with() -> None:
    observations = walked(CORNERS, np.random.default_rng(3), 40.0, heading_error_rad=1.0)
    trusting = errors_m(observations)
    wary = Liu2016Params(blending=BlendingParams((0.2, 0.5, 0.3), (0.0, 0.9, 0.1)))
    assert np.mean(errors_m(observations, wary)) < np.mean(trusting)


def test_a_phone_that_counts_no_steps_stays_about_where_it_is() -> None:
    rng = np.random.default_rng(4)
    moving = walked(CORNERS, rng, 20.0)
    x, y, _ = place_on(CORNERS, PACE_MPS * 20.0)
    rest = [scan(START_S + t, x, y, rng) for t in np.arange(20.0, 80.0, 2.0).tolist()]
    state = folded(moving)
    states = []
    for observation in rest:
        state, _ = advance(state, observation, SITE, PARAMS)
        states.append(state.track.mean)
    assert np.linalg.norm(np.std(states[10:], axis=0)[:2]) < 1.0
    assert np.abs(states[10:])[:, 2:].max() < 0.3


def test_without_any_sensor_it_follows_the_fixes_alone() -> None:
    observations = [
        o for o in walked(CORNERS, np.random.default_rng(5), 40.0) if isinstance(o, WifiScan)
    ]
    assert np.mean(errors_m(observations)) < 5.0


def stranger(time_s: float) -> WifiScan:
    keys = (f"mac:{i:012x}" for i in range(100, 108))
    return WifiScan(time_s, tuple(Reading((key,), -50.0) for key in keys))


@pytest.mark.parametrize(
    ("observation", "site", "reason"),
    [
        (WifiScan(START_S, ()), SITE, NoFixReason.NOTHING_HEARD),
        (stranger(START_S), SITE, NoFixReason.UNKNOWN_TRANSMITTERS),
        (
            WifiScan(
                START_S,
                (*stranger(START_S).readings, *scan(START_S, 20.0, 20.0).readings[:1]),
            ),
            SITE,
            NoFixReason.OUTSIDE_MAPPED_AREA,
        ),
        (
            scan(START_S, 5.0, 5.0),
            replace(SITE, radio_map=None),
            NoFixReason.NO_RADIO_MAP_OR_BEACONS,
        ),
        (
            BleScan(START_S, (Reading(("mac:000000000000",), -50.0),)),
            SITE,
            NoFixReason.NOTHING_HEARD,
        ),
    ],
)
def test_no_place_is_a_reason(observation, site, reason: NoFixReason) -> None:
    answer = answered([observation], site)
    assert isinstance(answer, NoFix)
    assert answer.reason is reason


def test_a_state_is_stored_with_its_memory_and_has_the_same_future() -> None:
    observations = walked(CORNERS, np.random.default_rng(6), 30.0)
    state, codec = folded(observations[:20]), TreeCodec(SessionState)
    restored = codec.decode(codec.encode(state))
    assert isinstance(restored.memory, BlendedMotion)
    for observation in observations[20:]:
        state, told = advance(state, observation, SITE, PARAMS)
        restored, again = advance(restored, observation, SITE, PARAMS)
        assert again == told
    assert codec.encode(restored) == codec.encode(state)
