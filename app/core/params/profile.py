"""All parameters of one profile."""

from dataclasses import dataclass, field

from app.core.params.fixes import LaterationParams, LevelOffsetParams, MatchParams
from app.core.params.motion import MotionModeParams, StepParams
from app.core.params.tracking import FloorParams, FusionParams, ReportParams, SmootherParams


def _best_lateration() -> LaterationParams:
    """Return what live phones need: their level offset is unknown, shadowing stays where it is."""
    return LaterationParams(offset_prior_db=5.0, shadowing_correlation=1.0, velocity_prior_mps=1.2)


@dataclass(frozen=True, slots=True)
class Params:
    """Parameters of a profile; a published one adds its own.

    Attributes
    ----------
    level_offset
        None: levels count as the phone tells them.
    smoother
        None: the system has no smoother, what is stored is its causal track.
    """

    profile: str = "best"
    match: MatchParams = field(default_factory=MatchParams)
    level_offset: LevelOffsetParams | None = field(default_factory=LevelOffsetParams)
    step: StepParams = field(default_factory=StepParams)
    fusion: FusionParams = field(default_factory=FusionParams)
    floor: FloorParams = field(default_factory=FloorParams)
    report: ReportParams = field(default_factory=ReportParams)
    smoother: SmootherParams | None = field(default_factory=SmootherParams)
    lateration: LaterationParams = field(default_factory=_best_lateration)
    motion_mode: MotionModeParams = field(default_factory=MotionModeParams)
