"""Stages of the absolute fix: fingerprints, the floor vote, the filter's update."""

import math

import numpy as np
from numba import njit

from app.core.changed import changed
from app.core.engine.match_noise import match_variance_m2
from app.core.engine.standing import ground_of
from app.core.engine.state import SessionState
from app.core.fingerprint.heard import Heard, heard_in
from app.core.fingerprint.level_offset import LevelOffset, first_offset, learned
from app.core.fingerprint.matching import Matches, match_heard
from app.core.fingerprint.query import Query, first_of, fresh_wifi_dbm, mean_ble_dbm, within
from app.core.fingerprint.radio_map import RadioMap
from app.core.fusion.particles import Particles, begin, update
from app.core.fusion.sighting import Sighting
from app.core.params import MatchParams, Params
from app.core.site import SiteModel
from app.core.types import (
    BleScan,
    FloatArray,
    IntArray,
    Method,
    NoFixReason,
    Used,
    WifiScan,
)


def match_fingerprints(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Params
) -> SessionState:
    """Match what is heard with the radio map: candidates for the floor vote and the filter."""
    radio_map = site.radio_map
    is_first = state.wifi_s is None
    state = changed(state, wifi_s=scan.time_s)
    if radio_map is None:
        return state if site.anchors else without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    choose = first_of(radio_map.column_by_key)
    # An old neighbourhood is better than none; the filter soon leaves it.
    max_age_s = params.match.first_max_age_s if is_first else params.match.max_age_s
    wifi_dbm = fresh_wifi_dbm(scan, max_age_s, choose)
    if len(wifi_dbm) < params.match.min_readings:
        return without(state, too_few(scan, params.match.min_readings))
    recent = within(state.heard, scan.time_s, params.match.ble_window_s)
    query = Query(wifi_dbm, mean_ble_dbm(recent, choose))
    if is_first and not site.anchors:
        # What a few beacons told alone is so much less that it would only hold the filter back.
        state = changed(state, track=None)
    return _match(state, query, scan.time_s, site, params)


def match_beacons(
    state: SessionState, scan: BleScan, site: SiteModel, params: Params
) -> SessionState:
    """Match advertisements alone, for phones that cannot scan Wi-Fi (iPhones) or may not now.

    A phone that has just begun may still scan. Where the beacons' positions are registered
    lateration does it instead.
    """
    radio_map = site.radio_map
    if radio_map is None or len(state.window) or may_scan_wifi(state, scan.time_s, params.match):
        return state
    query = Query({}, mean_ble_dbm(state.heard, first_of(radio_map.column_by_key)))
    if len(query.ble_dbm) < params.match.min_readings:
        few = NoFixReason.TOO_FEW_TRANSMITTERS if query.ble_dbm else NoFixReason.NOTHING_HEARD
        return without(state, few)
    return _match(state, query, scan.time_s, site, params)


def may_scan_wifi(state: SessionState, time_s: float, params: MatchParams) -> bool:
    """Return whether a Wi-Fi scan is still to be expected, which tells far more."""
    if state.wifi_s is not None:
        return time_s - state.wifi_s <= params.wifi_gap_s
    began_s = time_s if state.began_s is None else state.began_s
    return time_s - began_s < params.wifi_start_s


def too_few(scan: WifiScan, wanted: int) -> NoFixReason:
    """Return why a scan with fewer fresh readings than wanted is no fix."""
    if not scan.readings:
        return NoFixReason.NOTHING_HEARD
    stale = len(scan.readings) >= wanted
    return NoFixReason.READINGS_TOO_OLD if stale else NoFixReason.TOO_FEW_TRANSMITTERS


def _match(
    state: SessionState, query: Query, time_s: float, site: SiteModel, params: Params
) -> SessionState:
    radio_map = site.radio_map
    if radio_map is None:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    offset, heard, matches = _matched(state, heard_in(query, radio_map), radio_map, params)
    if matches is None:
        return without(state, NoFixReason.UNKNOWN_TRANSMITTERS)
    if offset is not None and params.level_offset is not None:
        offset = learned(offset, heard, matches, radio_map, params.level_offset)
        state = changed(state, level_offset=offset)
    if matches.nearest_sorensen > params.match.max_sorensen:
        return without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    votes = sums(matches.floor_index, matches.weight, len(site.floors))
    belief = believe(state, votes, time_s, params)
    known = params.match, params.fusion
    variance = match_variance_m2(query, matches.nearest_sorensen, radio_map, known)
    places = np.stack((matches.x_m, matches.y_m), axis=1)
    noise = (variance, 0.0, variance)
    sighting = Sighting(time_s, places, matches.weight, noise, votes, matches.floor_index)
    evidence = changed(state.evidence, sighting=sighting, means=Method.FINGERPRINT)
    used = Used(beacons=len(heard.ble), access_points=len(heard.wifi))
    return changed(state, floor_belief=belief, evidence=evidence, used=used)


def _matched(
    state: SessionState, heard: Heard, radio_map: RadioMap, params: Params
) -> tuple[LevelOffset | None, Heard, Matches | None]:
    """Return what is known of the phone's level offset, what is heard less it, and its matches.

    No offset: the profile takes levels as told.
    """
    offset = state.level_offset
    if params.level_offset is None:
        return None, heard, match_heard(heard, radio_map, params.match)
    if offset is None and len(heard.wifi):
        offset, matches = first_offset(heard, radio_map, params.match, params.level_offset)
        return offset, heard.less(offset.mean_db), matches
    offset = offset or LevelOffset(0.0, params.level_offset.prior_db**2)
    heard = heard.less(offset.mean_db)
    return offset, heard, match_heard(heard, radio_map, params.match)


def correct_particles(
    state: SessionState, scan: BleScan | WifiScan, site: SiteModel, params: Params
) -> SessionState:
    """Update the particle filter by the candidates that were matched, or begin it there."""
    _ = scan
    sighting = state.evidence.sighting
    if sighting is None:
        return state
    return correct(state, sighting, Method.FINGERPRINT, site, params)


def correct(
    state: SessionState, sighting: Sighting, method: Method, site: SiteModel, params: Params
) -> SessionState:
    """Update the track by a sighting, or begin it there."""
    floor = ground_of(state.floor_belief, site)
    evidence = changed(state.evidence, sighting=sighting, means=method)
    if isinstance(state.track, Particles):
        track = update(state.track, sighting, floor, params.fusion)
        method = Method.FUSED
    else:
        track = begin(sighting, floor, params.fusion)
    xx, _, yy = sighting.noise_m2
    return changed(
        state,
        track=track,
        told_s=sighting.time_s,
        sighted_m2=0.5 * (xx + yy),
        method=method,
        evidence=evidence,
    )


def believe(state: SessionState, votes: FloatArray, time_s: float, params: Params) -> FloatArray:
    """Return the probability of each floor after a vote.

    A Bayes filter: people change floors at ``change_rate_ps``, so belief leaks to the other floors
    with time (and can never be too sure to follow); a vote multiplies it by
    (w_f + ``vote_floor``)^``trust``.
    """
    prior = np.full(len(votes), 1.0 / len(votes))
    if state.floor_belief is not None:
        elapsed_s = time_s - (time_s if state.scanned_s is None else state.scanned_s)
        prior = leaked(state.floor_belief, elapsed_s, params)
    belief = prior * trusted(votes, params)
    return np.asarray(belief / belief.sum())


def leaked(belief: FloatArray, elapsed_s: float, params: Params) -> FloatArray:
    """Return a belief in floors after a time in which the carrier may have changed floors."""
    leak = 1.0 - math.exp(-params.floor.change_rate_ps * max(elapsed_s, params.floor.least_s))
    return _leaked(belief, leak)


@njit(cache=True)
def _leaked(belief: FloatArray, leak: float) -> FloatArray:  # pragma: no cover - compiled
    if len(belief) == 1:
        return belief
    others = (belief.sum() - belief) / (len(belief) - 1)
    return np.asarray((1.0 - leak) * belief + leak * others)


def trusted(votes: FloatArray, params: Params) -> FloatArray:
    """Return the likelihood of each floor that a vote amounts to."""
    return _trusted(votes, params.floor.vote_floor, params.floor.trust)


@njit(cache=True)
def _trusted(
    votes: FloatArray, vote_floor: float, trust: float
) -> FloatArray:  # pragma: no cover - compiled
    return np.asarray((votes / votes.sum() + vote_floor) ** trust)


def sums(group: IntArray, value: FloatArray, groups: int) -> FloatArray:
    """Return the sum of the values (n,) of each group (groups,)."""
    return np.bincount(group, value, groups).astype(np.float64)


def without(state: SessionState, reason: NoFixReason) -> SessionState:
    """Return the state with the reason why this observation told no place."""
    return changed(state, reason=reason)
