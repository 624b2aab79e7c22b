"""The pipeline: the ordered stages of one observation's way, on one screen."""

import math

from app.core.engine.order import event_time_s, order_key
from app.core.engine.state import SessionState
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import NoFix, NoFixReason, Observation, Output


def start() -> SessionState:
    """Return the state of a session that has seen nothing yet."""
    return SessionState()


def advance(
    state: SessionState, observation: Observation, site: SiteModel, params: Params
) -> tuple[SessionState, tuple[Output, ...]]:
    """Fold one observation; return the new state and one output per whole event second passed."""
    _ = site, params
    latest_s = max(event_time_s(observation), state.latest_s or -math.inf)
    return SessionState(order_key(observation), latest_s), ()


def finish(state: SessionState, site: SiteModel, params: Params) -> tuple[Output, ...]:
    """Return what the track would end with if nothing more came; the last one is the latest."""
    _ = site, params
    if state.latest_s is None:
        return ()
    return (NoFix(state.latest_s, NoFixReason.NOT_STARTED),)
