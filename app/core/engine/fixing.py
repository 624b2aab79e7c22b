"""Stages of the absolute fix: fingerprints or lateration, the floor vote, the filter's update."""

from dataclasses import replace

import numpy as np

from app.core.engine.state import SessionState
from app.core.fingerprint.matching import Matches, match
from app.core.fingerprint.query import Query, first_of, fresh_wifi_dbm, mean_ble_dbm, within
from app.core.fusion.mixture import Noise, begin, update
from app.core.lateration.windowed import Estimate, estimate
from app.core.motion.mode import decided, with_velocity
from app.core.params import FusionParams, Params
from app.core.radio.path_loss import LevelModel, level_model
from app.core.radio.windows import Window, of_anchors
from app.core.site import SiteModel
from app.core.types import (
    BleScan,
    FloatArray,
    IntArray,
    Method,
    MotionMode,
    NoFix,
    NoFixReason,
    Used,
    WifiScan,
)


def match_fingerprints(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Params
) -> SessionState:
    """Match what is heard with the radio map: candidates for the floor vote and the filter."""
    radio_map = site.radio_map
    if radio_map is None:
        return state if site.anchors else _without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    choose = first_of(radio_map.column_by_key)
    wifi_dbm = fresh_wifi_dbm(scan, params.match.max_age_s, choose)
    if len(wifi_dbm) < params.match.min_readings:
        stale = len(scan.readings) >= params.match.min_readings
        few = NoFixReason.TOO_FEW_TRANSMITTERS if wifi_dbm else NoFixReason.NOTHING_HEARD
        return _without(state, NoFixReason.READINGS_TOO_OLD if stale else few)
    recent = within(state.heard, scan.time_s, params.match.ble_window_s)
    query = Query(wifi_dbm, mean_ble_dbm(recent, choose))
    matches = match(query, radio_map, params.match)
    if matches is None:
        return _without(state, NoFixReason.UNKNOWN_TRANSMITTERS)
    if matches.nearest_sorensen > params.match.max_sorensen:
        return _without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    return _take_matches(state, matches, scan.time_s, _heard(query), (site, params))


def laterate(state: SessionState, scan: BleScan, site: SiteModel, params: Params) -> SessionState:
    """Estimate the place from the window's levels, on the floor that the anchors vote for."""
    if not len(state.window):
        return state if site.anchors else _without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    votes = _anchor_votes(state, site)
    belief = _believe(state, votes, scan.time_s, params)
    floor = int(np.argmax(belief))
    on_floor = np.array([site.floor_index(a.floor_id) == floor for a in site.anchors])
    model = level_model(site.anchors, params.lateration.phone_height_m)
    window = of_anchors(state.window, on_floor)
    state = replace(state, floor_belief=belief)
    found, state = _by_motion(state, window, model, scan.time_s, params)
    if isinstance(found, NoFix):
        return _without(state, found.reason)
    fix = found.fix
    widen = params.fusion.lateration_inflation
    noise = (
        widen * fix.covariance_m2[0] + params.fusion.lateration_floor_m2,
        widen * fix.covariance_m2[1],
        widen * fix.covariance_m2[2] + params.fusion.lateration_floor_m2,
    )
    places, weight = np.array([[fix.x_m, fix.y_m]]), np.ones(1)
    state = _correct(state, (places, weight, noise), scan.time_s, Method.LATERATION, params)
    return replace(state, used=replace(fix.used, steps=state.used.steps))


def _by_motion(
    state: SessionState, window: Window, model: LevelModel, time_s: float, params: Params
) -> tuple[Estimate | NoFix, SessionState]:
    """Solve with the model that fits the motion: kinematic for a walker, static at rest.

    Without steps or acceleration the kinematic model's own velocity tells which (its significance).
    """
    moving = estimate(window, model, time_s, kinematic=True, params=params.lateration)
    if isinstance(moving, Estimate) and moving.velocity_chi2 is not None:
        motion = with_velocity(state.motion, time_s, moving.velocity_chi2)
        state = replace(state, motion=motion)
    mode = decided(state.motion, time_s, params.motion_mode).mode
    if mode is MotionMode.WALKING:
        return moving, state
    return estimate(window, model, time_s, kinematic=False, params=params.lateration), state


def _take_matches(
    state: SessionState,
    matches: Matches,
    time_s: float,
    heard: Used,
    world: tuple[SiteModel, Params],
) -> SessionState:
    site, params = world
    votes = _sums(matches.floor_index, matches.weight, len(site.floors))
    belief = _believe(state, votes, time_s, params)
    places = np.column_stack([matches.x_m, matches.y_m])
    variance = _match_variance_m2(matches.nearest_sorensen, params.fusion)
    noise = (variance, 0.0, variance)
    state = _correct(state, (places, matches.weight, noise), time_s, Method.FINGERPRINT, params)
    return replace(state, floor_belief=belief, used=replace(heard, steps=state.used.steps))


def _correct(
    state: SessionState,
    seen: tuple[FloatArray, FloatArray, Noise],
    time_s: float,
    method: Method,
    params: Params,
) -> SessionState:
    places, weight, noise = seen
    if state.track is None:
        track = begin(places, weight, noise, params.fusion)
    else:
        track = update(state.track, places, weight, noise, params.fusion)
        method = Method.FUSED
    return replace(state, track=track, told_s=time_s, method=method)


def _match_variance_m2(nearest_sorensen: float, params: FusionParams) -> float:
    """Return the variance of a fingerprint's candidates about the truth: R = r0 (1 + r1 D1²).

    The less the nearest fingerprint resembles what is heard, the farther the phone is from it.
    """
    return params.noise_m2 * (1.0 + params.noise_sorensen * nearest_sorensen**2)


def _believe(state: SessionState, votes: FloatArray, time_s: float, params: Params) -> FloatArray:
    """Return the probability of each floor after a vote.

    A Bayes filter: people change floors at ``change_rate_ps``, so belief leaks to the other floors
    with time (and can never be too sure to follow); a vote multiplies it by
    (w_f + ``vote_floor``)^``trust``.
    """
    floors = len(votes)
    prior = np.full(floors, 1.0 / floors)
    if state.floor_belief is not None and floors > 1:
        elapsed_s = time_s - (time_s if state.told_s is None else state.told_s)
        leak = 1.0 - np.exp(-params.floor.change_rate_ps * max(elapsed_s, 0.5))
        others = (1.0 - state.floor_belief) / (floors - 1)
        prior = (1.0 - leak) * state.floor_belief + leak * others
    belief = prior * (votes / votes.sum() + params.floor.vote_floor) ** params.floor.trust
    return np.asarray(belief / belief.sum())


def _anchor_votes(state: SessionState, site: SiteModel) -> FloatArray:
    """Return each floor's share of the received power: slabs take 15 to 25 dB."""
    floor_of = np.array([site.floor_index(a.floor_id) for a in site.anchors])
    power = 10.0 ** (state.window.rssi_dbm / 10.0)
    return _sums(floor_of[state.window.anchor_index], power, len(site.floors))


def _sums(group: IntArray, value: FloatArray, groups: int) -> FloatArray:
    return np.bincount(group, value, groups).astype(np.float64)


def _heard(query: Query) -> Used:
    return Used(beacons=len(query.ble_dbm), access_points=len(query.wifi_dbm))


def _without(state: SessionState, reason: NoFixReason) -> SessionState:
    return replace(state, reason=reason)
