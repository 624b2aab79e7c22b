"""The stage of lateration: what the levels of known anchors tell the filter."""

import math
from dataclasses import replace

import numpy as np

from app.core.changed import changed
from app.core.engine.anchoring import anchor_floors, anchor_levels, anchor_votes, wall_loss_db
from app.core.engine.doubting import doubt, fault_of_heard, left_out
from app.core.engine.fixing import believe, correct, may_scan_wifi, without
from app.core.engine.place import place_of
from app.core.engine.state import SessionState
from app.core.engine.walking import is_motion_seen
from app.core.engine.windowing import sense_velocity
from app.core.fusion.particles import Particles, moments
from app.core.fusion.sighting import Noise, Sighting
from app.core.lateration.outside import Outside, OutsideParams, judged_outside, offset_on_plan
from app.core.lateration.posterior import (
    Costs,
    LocalLevels,
    PhoneOffset,
    PlacePosterior,
    PlacePrior,
    costs_of,
    local_levels,
    offset_at,
    place_posterior,
    stacked,
)
from app.core.lateration.surface import box_around
from app.core.lateration.windowed import WALKING_SPEED_MPS
from app.core.motion.mode import decided
from app.core.params import Params
from app.core.radio.path_loss import X, Y
from app.core.radio.windows import of_anchors
from app.core.site import Floor, SiteModel
from app.core.types import (
    BleScan,
    FloatArray,
    Method,
    MotionMode,
    NoFixReason,
    Used,
)

SETTLING_S, ALIKE_AT_FIRST = 10.0, 3.0
"""A first window has too few readings to average the fading of each, so where a phone begins at
rest its first seconds tell more than shadowing alone would let them."""

OUTSIDE = OutsideParams()


def laterate(state: SessionState, scan: BleScan, site: SiteModel, params: Params) -> SessionState:
    """Estimate the place from the window's levels, on the floor that the anchors vote for."""
    if site.radio_map is not None and not len(state.window):
        return state
    if not site.anchors:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    if not len(state.window):
        unknown = NoFixReason.UNKNOWN_TRANSMITTERS if scan.readings else NoFixReason.NOTHING_HEARD
        return without(state, unknown)
    votes = anchor_votes(state, site)
    belief = believe(state, votes, scan.time_s, params)
    floor = int(np.argmax(belief))
    window = of_anchors(state.window, anchor_floors(site) == floor)
    state = changed(state, floor_belief=belief)
    if window.anchors_heard < params.lateration.min_anchors:
        return without(state, NoFixReason.TOO_FEW_TRANSMITTERS)
    model = anchor_levels(site, params.lateration.phone_height_m)
    state = sense_velocity(state, window, model, scan.time_s, params)
    levels = local_levels(window, model, params.lateration.shadowing_correlation)
    levels = replace(levels, moved_m=_moved_since(state, levels.time_s, params))
    before = state
    state = _sight(state, levels, (site, floor), scan.time_s, votes, params)
    if state.lateration.told_s != scan.time_s:
        return state
    last_s = before.lateration.told_s
    worth = 1.0 / _alike(before, last_s, scan.time_s, params)
    elapsed_s = 0.0 if last_s is None else scan.time_s - last_s
    return doubt(state, (window, levels, model, worth), elapsed_s, (site, floor), params)


def _sight(
    state: SessionState,
    levels: LocalLevels,
    where: tuple[SiteModel, int],
    time_s: float,
    votes: FloatArray,
    params: Params,
) -> SessionState:
    site, floor = where
    model = anchor_levels(site, params.lateration.phone_height_m)
    memory, heard = state.lateration, len(levels.anchor_index)
    out = left_out(state, heard)
    fault = fault_of_heard(out, levels, site)
    at_large = PhoneOffset(0.0, params.lateration.offset_prior_db)
    offset = offset_on_plan(memory.offset or at_large, at_large, memory.outside, time_s, OUTSIDE)
    loss_db = stacked([wall_loss_db(site, int(i)) for i in levels.anchor_index])
    heard_m = model.table[levels.anchor_index, X : Y + 1]
    box = box_around(heard_m, params.lateration.search_margin_m)
    prior = PlacePrior(box, _plan_m(site.floors[floor], heard_m))
    found = place_posterior(levels, model, loss_db, offset, prior, fault)
    costs_at = costs_of(levels, model, loss_db, at_large, fault)
    outside = _judged(state, (costs_at, found.log_evidence_ratio), prior.plan_m, time_s, params)
    memory = replace(memory, outside=outside, offset=offset)
    state = changed(state, lateration=memory)
    if outside.is_told(OUTSIDE):
        return _left(state, site, time_s, params)
    if not _worst_variance_m2(found.covariance) <= params.lateration.max_sigma_m**2:
        return without(state, NoFixReason.DEGENERATE_GEOMETRY)
    alike = _alike(state, memory.told_s, time_s, params)
    noise = _noise(state, found, levels, alike, time_s, params)
    sighting = Sighting(time_s, found.mean[None, :], np.ones(1), noise, votes)
    state = correct(state, sighting, Method.LATERATION, site, _worth(params, alike))
    if state.track is not None:
        place, _ = place_of(state.track)
        # An anchor at fault says nothing of the phone.
        wary = replace(levels, sigma_db=levels.sigma_db * np.sqrt(alike / (1.0 - fault)))
        offset = offset_at(wary, model, loss_db, offset, place)
    return changed(
        state,
        used=Used(beacons=heard),
        evidence=changed(state.evidence, left_out=out),
        lateration=replace(memory, told_s=time_s, offset=offset),
    )


def _judged(
    state: SessionState,
    told: tuple[Costs, float],
    plan_m: FloatArray,
    time_s: float,
    params: Params,
) -> Outside:
    before = state.lateration.outside
    worth = 1.0
    if before is not None:
        way_m = _way_m(state, before.time_s, time_s, params)
        worth = math.tanh(way_m / (2.0 * OUTSIDE.correlation_m))
    return judged_outside(before, (*told, worth), plan_m, time_s, OUTSIDE)


def _left(state: SessionState, site: SiteModel, time_s: float, params: Params) -> SessionState:
    """Return the state of a phone outside: without a place, unless its Wi-Fi may still tell one."""
    state = without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    if site.radio_map is not None and may_scan_wifi(state, time_s, params.match):
        return state
    return changed(state, track=None)


def _noise(
    state: SessionState,
    found: PlacePosterior,
    levels: LocalLevels,
    alike: float,
    time_s: float,
    params: Params,
) -> Noise:
    """Return a fix's covariance as the filter takes it.

    A walker whose strides nobody tells may have gone on since the middle of the window, to any
    side.
    """
    gone_m2 = 0.0
    walking = decided(state.motion, time_s, params.motion_mode).mode is MotionMode.WALKING
    if walking and not is_motion_seen(state, time_s, params):
        gone_m2 = 0.5 * (WALKING_SPEED_MPS * (time_s - float(levels.time_s.mean()))) ** 2
    (xx, xy), (_, yy) = found.covariance
    return alike * float(xx) + gone_m2, alike * float(xy), alike * float(yy) + gone_m2


def _worth(params: Params, alike: float) -> Params:
    """Return the parameters with which the filter takes a fix that tells 1 / alike of another.

    That is in its variance already; so much less does it say of where else the phone may be.
    """
    share = params.fusion.birth_share / alike
    return replace(params, fusion=replace(params.fusion, tempering=1.0, birth_share=share))


def _alike(state: SessionState, told_s: float | None, time_s: float, params: Params) -> float:
    """Return how many fixes like this one, after one at ``told_s``, tell as much as a new one.

    Shadowing is fixed to the place: after the way d its correlation is ``rho = exp(-d / d_0)``
    (Gudmundson 1991), and errors that are correlated so average like white ones of
    ``(1 + rho) / (1 - rho)`` times their variance.
    """
    if told_s is None:
        return 1.0
    way_m = max(_way_m(state, told_s, time_s, params), 1e-3)
    alike = 1.0 / math.tanh(way_m / (2.0 * params.lateration.correlation_m))
    if state.began_s is not None and time_s - state.began_s < SETTLING_S:
        return min(alike, ALIKE_AT_FIRST)
    return alike


def _way_m(state: SessionState, since_s: float, time_s: float, params: Params) -> float:
    """Return how far the phone has gone, as far as shadowing is concerned."""
    elapsed_s, lateration = max(time_s - since_s, 0.0), params.lateration
    way_m = lateration.still_speed_mps * elapsed_s
    if is_motion_seen(state, time_s, params):
        return way_m + sum(stride.length_m for stride in state.walked if stride.time_s > since_s)
    return way_m + lateration.unseen_speed_mps * elapsed_s


def _moved_since(state: SessionState, time_s: FloatArray, params: Params) -> FloatArray:
    """Return how far the strides have led since times (n,), (n, 2), as the filter turns them."""
    moved = np.zeros((len(time_s), 2))
    if not isinstance(state.track, Particles):
        return moved
    bias_rad, scale = moments(state.track)[0][2:]
    for stride in state.walked:
        if not math.isnan(stride.heading_rad):
            direction = stride.heading_rad + float(bias_rad)
            step = np.array([math.cos(direction), math.sin(direction)])
            length_m = stride.length_m * float(scale)
            # A stride is walked evenly over its time.
            seconds = stride.seconds if stride.seconds > 0.0 else 1.0 / params.step.cadence_hz
            share = np.clip((stride.time_s - time_s) / seconds, 0.0, 1.0)
            moved += share[:, None] * length_m * step
    return moved


def _plan_m(floor: Floor, anchors_m: FloatArray) -> FloatArray:
    """Return left, low, right and high of a plan; anchors that lie outside make it larger."""
    low = np.minimum([floor.x0_m, floor.y0_m], anchors_m.min(axis=0))
    plan_high = [floor.x0_m + floor.width_m, floor.y0_m + floor.height_m]
    high = np.maximum(plan_high, anchors_m.max(axis=0))
    return np.concatenate((low, high))


def _worst_variance_m2(covariance: FloatArray) -> float:
    return float(np.linalg.eigvalsh(covariance)[1])
