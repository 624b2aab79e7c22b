"""The fold: one observation's way through the stages of its profile, and the passing of time."""

import math

from app.core.changed import changed
from app.core.engine.order import order_key
from app.core.engine.profiles import PROFILES
from app.core.engine.report import report
from app.core.engine.state import Evidence, SessionState, Told
from app.core.engine.walking import take_strides
from app.core.motion.mode import decided
from app.core.params import Params
from app.core.session import event_time_s
from app.core.site import SiteModel
from app.core.types import BleScan, Method, NoFixReason, Observation, Output, WifiScan


def advance(
    state: SessionState, observation: Observation, site: SiteModel, params: Params
) -> tuple[SessionState, tuple[Output, ...]]:
    """Fold one observation; return the new state and one output per whole event second passed.

    Observations come in the order of `order_key`. The position of second k rests on everything
    that was observed at or before k, and on nothing later.
    """
    time_s = observation.time_s
    profile = PROFILES[params.profile]
    state = changed(state, evidence=Evidence())
    state, outputs = _pass_time(state, time_s, site, params)
    state = take_strides(state, time_s, profile.stride, site, params)
    before = state
    for stage in profile.stages[type(observation)]:
        state = stage(state, observation, site, params)
    told = _told(before, state, observation, params)
    # Steps that the phone tells are over by the time it tells them.
    state = take_strides(state, time_s, profile.stride, site, params)
    return (
        changed(
            state,
            last_key=order_key(observation),
            latest_s=max(event_time_s(observation), time_s, state.latest_s or time_s),
            now_s=time_s,
            began_s=time_s if state.began_s is None else state.began_s,
            scanned_s=time_s if isinstance(observation, BleScan | WifiScan) else state.scanned_s,
            motion=decided(state.motion, time_s, params.motion_mode),
            told=told,
            # A reason of before a fix is none for what comes after it.
            reason=NoFixReason.NOTHING_HEARD if state.told_s == time_s else state.reason,
        ),
        outputs,
    )


def finish(state: SessionState, site: SiteModel, params: Params) -> tuple[Output, ...]:
    """Return what the track would end with if nothing more came; the last one is the latest."""
    return end(state, site, params)[1]


def end(
    state: SessionState, site: SiteModel, params: Params
) -> tuple[SessionState, tuple[Output, ...]]:
    """Return the state after all that is still waiting, and the outputs of `finish`."""
    if state.latest_s is None:
        return state, ()
    end_s = state.latest_s
    state, outputs = _pass_time(changed(state, evidence=Evidence()), end_s, site, params)
    state = take_strides(state, end_s, PROFILES[params.profile].stride, site, params)
    return state, (*outputs, report(state, end_s, site, params))


def _told(
    before: SessionState, after: SessionState, observation: Observation, params: Params
) -> Told | None:
    """Return the newest scan that told the place, of the last ``fused_s``; else the newest."""
    told, evidence = before.told, after.evidence
    if not isinstance(observation, BleScan | WifiScan):
        return told
    means = evidence.means
    if means is None and after.told_s == observation.time_s:
        # A profile without a filter tells the place without a sighting.
        means = after.method
    if means is None and told is not None and told.means is not None:
        age_s = observation.time_s - told.scan.time_s
        if age_s <= params.report.fused_s:
            return told
    heard = () if means is Method.LATERATION else after.heard
    return Told(observation, heard, after.window, before.track, after.track, evidence, means)


def _pass_time(
    state: SessionState, to_s: float, site: SiteModel, params: Params
) -> tuple[SessionState, tuple[Output, ...]]:
    """Report every whole second in ``[now, to)``, each after the strides up to it.

    In a long silence reports stop ``silence_s`` after the last word of the phone.
    """
    if state.now_s is None or state.latest_s is None:
        return state, ()
    rule = PROFILES[params.profile].stride
    outputs: list[Output] = []
    until_s = min(to_s, max(state.latest_s, state.now_s) + params.report.silence_s)
    second = math.ceil(state.now_s)
    while second < until_s:
        state = take_strides(state, float(second), rule, site, params)
        outputs.append(report(state, float(second), site, params))
        second += 1
    return state, tuple(outputs)
