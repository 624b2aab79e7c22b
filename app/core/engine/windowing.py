"""Windowed least squares on the anchors of one floor, by the model that fits the motion."""

from dataclasses import replace

import numpy as np

from app.core.changed import changed
from app.core.engine.anchoring import anchor_floors, anchor_levels, anchor_votes
from app.core.engine.fixing import believe
from app.core.engine.state import SessionState
from app.core.lateration.windowed import Estimate, estimate
from app.core.motion.mode import decided, with_velocity
from app.core.params import Params
from app.core.radio.path_loss import LevelModel
from app.core.radio.windows import Window, of_anchors
from app.core.site import SiteModel
from app.core.types import BleScan, FloatArray, MotionMode, NoFix, NoFixReason

MOST_CORRELATED = 0.9
"""A velocity is told by how levels change within the window. Were their errors taken for wholly
alike there, no change would mean anything."""


def solve_window(
    state: SessionState, scan: BleScan, site: SiteModel, params: Params
) -> tuple[Estimate | NoFix, FloatArray, SessionState]:
    """Return where the window's levels come from, the floor votes of its anchors, and the state.

    The state then knows what the levels tell of motion and floor.
    """
    votes = anchor_votes(state, site)
    if not len(state.window):
        unknown = NoFixReason.UNKNOWN_TRANSMITTERS if scan.readings else NoFixReason.NOTHING_HEARD
        return NoFix(scan.time_s, unknown), votes, state
    belief = believe(state, votes, scan.time_s, params)
    window = of_anchors(state.window, anchor_floors(site) == int(np.argmax(belief)))
    model = anchor_levels(site, params.lateration.phone_height_m)
    state = sense_velocity(changed(state, floor_belief=belief), window, model, scan.time_s, params)
    walking = decided(state.motion, scan.time_s, params.motion_mode).mode is MotionMode.WALKING
    lateration = params.lateration
    found = estimate(window, model, scan.time_s, kinematic=walking, params=lateration)
    return found, votes, state


def sense_velocity(
    state: SessionState, window: Window, model: LevelModel, time_s: float, params: Params
) -> SessionState:
    """Let the significance of the kinematic model's velocity tell of motion, if no sensor does."""
    if state.motion.last_step_s is not None or state.motion.acc_s is not None:
        return state
    lateration = params.lateration
    correlation = min(lateration.shadowing_correlation, MOST_CORRELATED)
    lateration = replace(lateration, shadowing_correlation=correlation)
    moving = estimate(window, model, time_s, kinematic=True, params=lateration)
    if not isinstance(moving, Estimate) or moving.velocity_chi2 is None:
        return state
    return changed(state, motion=with_velocity(state.motion, time_s, moving.velocity_chi2))
