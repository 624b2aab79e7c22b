"""The last stage: what the session says at an instant, a track point or the reason for none."""

import math

from app.core.engine.place import moments_of, velocity_mps
from app.core.engine.state import SessionState
from app.core.engine.walking import is_motion_seen
from app.core.lateration.outside import reaching_radius95_m
from app.core.motion.mode import decided
from app.core.params import Params, ReportParams
from app.core.site import SiteModel
from app.core.types import (
    FloatArray,
    Method,
    MotionMode,
    NoFix,
    NoFixReason,
    Output,
    TrackPoint,
)

CIRCLE95_CHI2 = 5.99
"""95 % point of chi-square, 2 degrees: squared radius over variance per axis, of a circle."""


def report(state: SessionState, time_s: float, site: SiteModel, params: Params) -> Output:
    """Return the session's position at ``time_s``, up to which the state has been walked."""
    if state.track is None or state.floor_belief is None or state.told_s is None:
        return NoFix(time_s, state.reason)
    age_s = time_s - state.told_s
    if age_s > params.report.max_age_s:
        return NoFix(time_s, _reason_since(state, time_s, params.report))
    mean, covariance = moments_of(state.track)
    mode = decided(state.motion, time_s, params.motion_mode).mode
    vx, vy = 0.0, 0.0
    if mode is MotionMode.WALKING:
        vx, vy = velocity_mps(state.track, mean, state.stride)
    scale, extra_m2 = _spread_of(state, time_s, params.report)
    extra_m2 += _grown_m2(state, age_s, time_s, params)
    xx, xy, yy = calibrated(covariance, scale, extra_m2)
    beyond_m2 = _beyond_m2(state, mean[:2], (xx, xy, yy))
    xx, yy = xx + beyond_m2, yy + beyond_m2
    floor = int(state.floor_belief.argmax())
    return TrackPoint(
        time_s=time_s,
        floor_id=site.floors[floor].floor_id,
        x_m=float(mean[0]),
        y_m=float(mean[1]),
        covariance_m2=(xx, xy, yy),
        radius95_m=radius95_m(xx, xy, yy),
        speed_mps=math.hypot(vx, vy),
        heading_rad=math.atan2(vy, vx) if vx or vy else None,
        motion=mode,
        method=state.method if age_s <= params.report.fused_s else Method.DEAD_RECKONING,
        floor_confidence=float(state.floor_belief[floor]),
        used=state.used,
        age_s=age_s,
        profile=params.profile,
    )


def _reason_since(state: SessionState, time_s: float, params: ReportParams) -> NoFixReason:
    """Return why nothing has told the place since the last fix: what the last scan said of it."""
    if state.scanned_s is None or time_s - state.scanned_s > params.max_age_s:
        return NoFixReason.NOTHING_HEARD
    return state.reason


def _beyond_m2(
    state: SessionState,
    place_m: FloatArray,
    covariance_m2: tuple[float, float, float],
) -> float:
    """Return the variance per axis that lets the radius reach where the phone is if outside.

    What was not told by anchors does not rest on the phone being on the plan.
    """
    outside = state.lateration.outside
    if outside is None or state.lateration.told_s != state.told_s:
        return 0.0
    radius_m = radius95_m(*covariance_m2)
    reach_m = reaching_radius95_m(radius_m, place_m, outside)
    return max(reach_m**2 - radius_m**2, 0.0) / CIRCLE95_CHI2


def _spread_of(state: SessionState, time_s: float, params: ReportParams) -> tuple[float, float]:
    """Return scale and extra variance: as fitted on radio maps, or as anchors have told lately."""
    told_s = state.lateration.told_s
    if told_s is not None and time_s - told_s <= params.laterated_s:
        return params.laterated_scale, params.laterated_extra_m2
    extra_m2 = params.extra_variance_m2
    if state.sighted_m2 is not None:
        extra_m2 += params.sighted_share * state.sighted_m2
    return params.covariance_scale, extra_m2


def _grown_m2(state: SessionState, age_s: float, time_s: float, params: Params) -> float:
    """Return how much the variance has grown since the last fix, ``age_s`` ago: by dead reckoning.

    While fixes come their own errors are what was fitted. Where motion would have been seen, the
    phone has moved until its last step at the latest.
    """
    if age_s <= params.report.fused_s:
        return 0.0
    moved_s = age_s
    if is_motion_seen(state, time_s, params):
        last_step_s = state.motion.last_step_s
        moved_s = 0.0 if last_step_s is None else max(age_s - (time_s - last_step_s), 0.0)
    return params.report.unfixed_m2ps * moved_s


def radius95_m(xx: float, xy: float, yy: float) -> float:
    """Return the radius of the circle around the mean that holds 95 % of a plane normal.

    With standard deviations a >= b along the axes, r = a (1.96 + 0.488 (b/a)^2.5): 1.96 for a line,
    2.448 for a circle; within 0.6 % of the exact value between (fitted by us to a simulation of two
    million draws).
    """
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    a2, b2 = middle + half, max(middle - half, 0.0)
    if a2 <= 0.0:
        return 0.0
    return math.sqrt(a2) * (1.96 + 0.488 * math.pow(b2 / a2, 1.25))


def calibrated(covariance: FloatArray, scale: float, extra_m2: float) -> tuple[float, float, float]:
    """Return the position's covariance with what the filter cannot know, from real walks."""
    (xx, xy), (_, yy) = covariance.tolist()
    return scale * xx + extra_m2, scale * xy, scale * yy + extra_m2
