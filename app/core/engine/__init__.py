"""The fold: ``advance(state, observation, site, params) -> (state, outputs)``."""

from app.core.engine.explaining import explained
from app.core.engine.explanation import Explanation
from app.core.engine.order import OrderKey, in_order, order_key
from app.core.engine.pipeline import advance, finish
from app.core.engine.profiles import PROFILES, Profile
from app.core.engine.smoothing import smoothed
from app.core.engine.state import SessionState, start
from app.core.engine.warmup import prepare, warm_up

__all__ = [
    "PROFILES",
    "Explanation",
    "OrderKey",
    "Profile",
    "SessionState",
    "advance",
    "explained",
    "finish",
    "in_order",
    "order_key",
    "prepare",
    "smoothed",
    "start",
    "warm_up",
]
