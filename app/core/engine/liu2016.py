"""The published system liu2016: Wi-Fi and motion sensors, speed and heading blended at each scan.

A scan's nearest neighbours are a fix. The first one begins the track. At each later one the speed
and the heading of the last output, of the way from there to the fix, and of the pedometer and the
phone are blended, and a constant-velocity filter follows the blended velocity and the fix. Between
scans the filter follows the velocity of each stride. Bluetooth is not used.

Where the paper takes the sensors' speed from integrated acceleration, steps tell it here: that is
what a phone in the hand can measure for more than half a minute.

Source: Liu, Jiang, Liu, Chen, "Multi-sensor fusion based indoor real-time and highly accurate
trajectory generation", Computer Science 43(1), 2016.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from app.core.changed import changed
from app.core.engine.fixing import believe, sums, too_few, without
from app.core.engine.state import SessionState, Stride
from app.core.engine.walking import is_motion_seen
from app.core.fingerprint.query import first_of, fresh_wifi_dbm
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.unequal_length import (
    Neighbours,
    UnequalLengthParams,
    nearest_of_unequal_length,
)
from app.core.fusion.blending import (
    BlendedMotion,
    BlendingParams,
    SensedMotion,
    WifiFix,
    blended,
)
from app.core.fusion.constant_velocity import (
    ConstantVelocityParams,
    begun_at,
    followed,
    moved_on,
    with_velocity,
)
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.params import LevelOffsetParams, Params, ReportParams, SmootherParams
from app.core.site import SiteModel
from app.core.types import BleScan, FloatArray, Method, NoFixReason, Used, WifiScan

AT_REST = (0.0, 0.0)


def _report() -> ReportParams:
    """Return how P is told: the errors of fixes are alike for seconds, and P takes them for new.

    Fitted on ms2020's tuning walks: 95 % of the truth within ``radius95_m``.
    """
    return ReportParams(covariance_scale=3.6, extra_variance_m2=6.0)


@dataclass(frozen=True, slots=True)
class Liu2016Params(Params):
    """Parameters of liu2016: the published weights, and those the paper does not print."""

    profile: str = "liu2016"
    neighbours: UnequalLengthParams = field(default_factory=UnequalLengthParams)
    blending: BlendingParams = field(default_factory=BlendingParams)
    velocity: ConstantVelocityParams = field(default_factory=ConstantVelocityParams)
    report: ReportParams = field(default_factory=_report)
    level_offset: LevelOffsetParams | None = None
    smoother: SmootherParams | None = None


def pass_over_beacons(
    state: SessionState, scan: BleScan, site: SiteModel, params: Liu2016Params
) -> SessionState:
    """Learn nothing from Bluetooth, but why there is no fix if that is all there is."""
    _ = scan, params
    if site.radio_map is None:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    if state.wifi_s is None:
        return without(state, NoFixReason.NOTHING_HEARD)
    return state


def blend_scan(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Liu2016Params
) -> SessionState:
    """Follow a scan's fix, or begin the track with it."""
    radio_map = site.radio_map
    state = changed(state, wifi_s=scan.time_s)
    if radio_map is None:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    levels_dbm = _levels_dbm(state, scan, radio_map, params)
    if len(levels_dbm) < params.match.min_readings:
        return without(state, too_few(scan, params.match.min_readings))
    found = nearest_of_unequal_length(levels_dbm, radio_map, params.neighbours)
    if found is None:
        return without(state, NoFixReason.UNKNOWN_TRANSMITTERS)
    if found.distance_db[0] > params.neighbours.outside_db:
        return without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    votes = sums(found.floor_index, found.weight, len(site.floors))
    belief = believe(state, votes, scan.time_s, params)
    state = changed(state, floor_belief=belief, used=Used(access_points=len(levels_dbm)))
    places, weight = _on_floor(found, int(np.argmax(belief)))
    variance_m2 = params.velocity.place_sigma_m**2
    noise_m2 = variance_m2, 0.0, variance_m2
    return _follow(state, Sighting(scan.time_s, places, weight, noise_m2, votes), params)


def blend_stride(
    state: SessionState, stride: Stride, site: SiteModel, params: Liu2016Params
) -> SessionState:
    """Let the filter follow the velocity of a stride, and remember it for the next blending."""
    _ = site
    track, motion = state.track, state.memory
    if not isinstance(track, PlanarTrack) or not isinstance(motion, BlendedMotion):
        return state
    track = moved_on(
        track, max(stride.time_s - motion.filtered_s, 0.0), params.velocity.velocity_walk_mps
    )
    x, y = 0.0, 0.0
    if not math.isnan(stride.heading_rad):
        x = stride.length_m * math.cos(stride.heading_rad)
        y = stride.length_m * math.sin(stride.heading_rad)
        seconds = 1.0 / params.step.cadence_hz if math.isnan(stride.seconds) else stride.seconds
        velocity_mps = x / seconds, y / seconds
        track = with_velocity(track, velocity_mps, params.velocity.stride_sigma_mps)
    motion = replace(
        motion,
        walked_x_m=motion.walked_x_m + x,
        walked_y_m=motion.walked_y_m + y,
        strides=motion.strides + 1,
        filtered_s=max(stride.time_s, motion.filtered_s),
    )
    return changed(state, track=track, memory=motion)


def _levels_dbm(
    state: SessionState, scan: WifiScan, radio_map: RadioMap, params: Liu2016Params
) -> dict[str, float]:
    choose = first_of(radio_map.column_by_key)
    levels_dbm = fresh_wifi_dbm(scan, params.match.max_age_s, choose)
    if len(levels_dbm) < params.match.min_readings and state.track is None:
        # An old neighbourhood is better than none; the filter soon leaves it.
        return fresh_wifi_dbm(scan, params.match.first_max_age_s, choose)
    return levels_dbm


def _on_floor(found: Neighbours, floor_index: int) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) and weights (n,) of the neighbours on a floor; if none is, of all."""
    here = found.floor_index == floor_index
    if not here.any():
        here = np.ones(len(here), dtype=np.bool_)
    weight = found.weight[here]
    return np.column_stack([found.x_m, found.y_m])[here], weight / weight.sum()


def _follow(state: SessionState, sighting: Sighting, params: Liu2016Params) -> SessionState:
    place = sighting.weight @ sighting.places
    time_s = sighting.time_s
    track, motion, method = state.track, state.memory, Method.FUSED
    if not isinstance(track, PlanarTrack) or not isinstance(motion, BlendedMotion):
        method = Method.FINGERPRINT
        velocity = params.velocity
        track = begun_at(place, velocity.place_sigma_m, velocity.begin_sigma_mps)
        motion = BlendedMotion(time_s, float(place[0]), float(place[1]), filtered_s=time_s)
    elif time_s > motion.time_s:
        track, motion = _blended(state, track, motion, (time_s, place), params)
    evidence = changed(state.evidence, sighting=sighting)
    return changed(
        state, track=track, memory=motion, told_s=time_s, method=method, evidence=evidence
    )


def _blended(
    state: SessionState,
    track: PlanarTrack,
    motion: BlendedMotion,
    fix: tuple[float, FloatArray],
    params: Liu2016Params,
) -> tuple[PlanarTrack, BlendedMotion]:
    time_s, place = fix
    sensed = _sensed(state, motion, time_s, params)
    wifi = WifiFix(time_s, float(place[0]), float(place[1]))
    moved = blended(motion, wifi, sensed, params.blending)
    seconds = max(time_s - motion.filtered_s, 0.0)
    rests = sensed.speed_mps == 0.0
    if rests:
        track = with_velocity(track, AT_REST, params.velocity.stride_sigma_mps)
    velocity_mps = AT_REST if rests else moved.velocity_mps
    track = followed(track, seconds, velocity_mps, place, params.velocity)
    x_m, y_m = track.mean[:2].tolist()
    return track, replace(moved, x_m=x_m, y_m=y_m, filtered_s=time_s)


def _sensed(
    state: SessionState, motion: BlendedMotion, time_s: float, params: Liu2016Params
) -> SensedMotion:
    """Return what the pedometer and the phone tell of the time since the last scan.

    Without a sensor, or in a gap of it, the last speed stands and no heading is known.
    """
    if not is_motion_seen(state, time_s, params):
        return SensedMotion(math.nan)
    if not motion.strides:
        return SensedMotion(motion.heading_rad, speed_mps=0.0)
    walked_m = math.hypot(motion.walked_x_m, motion.walked_y_m)
    if walked_m == 0.0:
        return SensedMotion(math.nan)
    heading_rad = math.atan2(motion.walked_y_m, motion.walked_x_m)
    return SensedMotion(heading_rad, speed_mps=walked_m / (time_s - motion.time_s))
