"""Stages of motion: strides from the phone's sensors, and the filter carried along by them."""

import math
from collections.abc import Callable
from typing import Any, TypeAlias

from app.core.changed import changed
from app.core.engine.standing import ground_of
from app.core.engine.state import SessionState, Stride
from app.core.fusion.particles import Particles, diffuse, walk
from app.core.motion.mode import with_acceleration, with_step
from app.core.motion.steps import detect_steps, step_length_m
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import (
    BleScan,
    ImuBlock,
    Pedometer,
    Steps,
    Used,
    WifiScan,
)

StrideRule: TypeAlias = Callable[[SessionState, Stride, SiteModel, Any], SessionState]
"""What one stride does to a profile's track: state, stride, site and its parameters."""

WALKED_S = 5.0
"""Strides are remembered so long: any window of levels is shorter."""


def sense_motion(
    state: SessionState, block: ImuBlock, site: SiteModel, params: Params
) -> SessionState:
    """Let the acceleration speak on whether its carrier walks."""
    _ = site
    return changed(state, motion=with_acceleration(state.motion, block, params.motion_mode))


def find_strides(
    state: SessionState, block: ImuBlock, site: SiteModel, params: Params
) -> SessionState:
    """Find the steps of a block; they wait until their time comes.

    Where the phone tells steps itself they are only used for its heading.
    """
    detector, steps = detect_steps(state.detector, block, params.step)
    if state.phone_steps_s is not None:
        return changed(state, detector=detector)
    strides = tuple(
        Stride(s.time_s, step_length_m(s, params.step), _on_plan(s.heading_rad, site), s.interval_s)
        for s in steps
    )
    return changed(state, detector=detector, pending=state.pending + strides)


def take_phone_steps(
    state: SessionState, steps: Steps, site: SiteModel, params: Params
) -> SessionState:
    """Walk the steps that the phone tells, with its heading or the one our detector follows."""
    heading_rad = steps.heading_rad
    if heading_rad is None:
        heading_rad = state.detector.heading_rad
    heading_rad = _on_plan(heading_rad, site)
    length_m = params.step.usual_length_m if steps.step_length_m is None else steps.step_length_m
    seconds = 1.0 / params.step.cadence_hz
    strides = tuple(
        Stride(steps.time_s, length_m, heading_rad, seconds) for _ in range(steps.count)
    )
    return _believe_phone(state, strides, steps.time_s)


def spread_pedometer(
    state: SessionState, interval: Pedometer, site: SiteModel, params: Params
) -> SessionState:
    """Walk a pedometer interval's steps, spread evenly over its time, with our detector's heading.

    They are over by now. Those before the last stride taken were told or found already.
    """
    if not interval.steps:
        return state
    seconds = (interval.time_s - interval.begin_s) / interval.steps
    length_m = params.step.usual_length_m
    if interval.distance_m is not None:
        length_m = interval.distance_m / interval.steps
    heading_rad = _on_plan(state.detector.heading_rad, site)
    known_s = -math.inf if state.stride is None else state.stride.time_s
    times_s = (interval.time_s - seconds * i for i in reversed(range(interval.steps)))
    strides = tuple(Stride(t, length_m, heading_rad, seconds) for t in times_s if t > known_s)
    return _believe_phone(state, strides, interval.time_s)


def _believe_phone(state: SessionState, strides: tuple[Stride, ...], time_s: float) -> SessionState:
    # From the phone's first word on, what our detector still has waiting would count twice.
    return changed(state, pending=strides, phone_steps_s=time_s)


def _on_plan(heading_rad: float, site: SiteModel) -> float:
    """Turn a heading that the phone reports, from east, into one from the plan's +x."""
    return heading_rad - site.x_axis_from_east_rad


def walk_particles(
    state: SessionState, stride: Stride, site: SiteModel, params: Params
) -> SessionState:
    """Move the particle filter by a stride."""
    if not isinstance(state.track, Particles):
        return state
    step = stride.length_m, stride.heading_rad
    track = walk(state.track, step, ground_of(state.floor_belief, site), params.fusion)
    return changed(state, track=track)


def stay(state: SessionState, stride: Stride, site: SiteModel, params: Params) -> SessionState:
    """Leave the track where it is: a stride tells of motion, not of place."""
    _ = stride, site, params
    return state


def take_strides(
    state: SessionState, until_s: float, rule: StrideRule, site: SiteModel, params: Params
) -> SessionState:
    """Move the filter by the strides whose time has come."""
    if not state.pending or state.pending[0].time_s > until_s:
        return state
    due = 1
    while due < len(state.pending) and state.pending[due].time_s <= until_s:
        due += 1
    taken = state.pending[:due]
    for stride in taken:
        state = rule(state, stride, site, params)
    return changed(
        state,
        motion=with_step(state.motion, max(stride.time_s for stride in taken)),
        stride=taken[-1],
        pending=state.pending[due:],
        walked=_lately(state.walked + taken, until_s),
        evidence=changed(state.evidence, strides=state.evidence.strides + taken),
        used=Used(state.used.beacons, state.used.access_points, state.used.steps + due),
    )


def _lately(walked: tuple[Stride, ...], time_s: float) -> tuple[Stride, ...]:
    return tuple(stride for stride in walked if stride.time_s > time_s - WALKED_S)


def diffuse_unseen(
    state: SessionState, scan: BleScan | WifiScan, site: SiteModel, params: Params
) -> SessionState:
    """Widen the filter for motion that no sensor would have shown."""
    if not isinstance(state.track, Particles) or state.scanned_s is None:
        return state
    drift_m2 = unseen_drift_m2(state, scan.time_s, params)
    track, evidence = state.track, changed(state.evidence, drift_m2=drift_m2)
    if drift_m2 > 0.0:
        track = diffuse(track, drift_m2, ground_of(state.floor_belief, site))
    return changed(state, track=track, evidence=evidence)


def unseen_drift_m2(state: SessionState, time_s: float, params: Params) -> float:
    """Return how much each axis' variance grew since the last scan by motion not shown.

    With an inertial sensor or a step counter no steps means no motion (but for a little sway);
    without one, or in a gap of it, the phone may have gone anywhere at walking pace.
    """
    elapsed_s = time_s - (time_s if state.scanned_s is None else state.scanned_s)
    seen = is_motion_seen(state, time_s, params)
    rate = params.fusion.sway_m2ps if seen else params.fusion.unseen_m2ps
    return rate * elapsed_s


def is_motion_seen(state: SessionState, time_s: float, params: Params) -> bool:
    """Return whether a sensor or a step counter would show that the phone moves now."""
    inertial = state.detector.end_s > time_s - params.fusion.sensor_gap_s
    return inertial or state.phone_steps_s is not None
