"""Parameters of the engine: physics and choices, each with unit, reason and source."""

from app.core.params.fixes import LaterationParams, LevelOffsetParams, MatchParams
from app.core.params.motion import MotionModeParams, StepParams
from app.core.params.profile import Params
from app.core.params.tracking import FloorParams, FusionParams, ReportParams, SmootherParams

__all__ = [
    "FloorParams",
    "FusionParams",
    "LaterationParams",
    "LevelOffsetParams",
    "MatchParams",
    "MotionModeParams",
    "Params",
    "ReportParams",
    "SmootherParams",
    "StepParams",
]
