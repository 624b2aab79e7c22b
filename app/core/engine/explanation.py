"""What an explanation consists of; `app.core.engine.explaining` makes it."""

from dataclasses import dataclass
from enum import StrEnum

from app.core.lateration.faults import Fault
from app.core.motion.mode import MotionEvidence
from app.core.types import Method, MotionMode, Output


class Use(StrEnum):
    """What became of a transmitter that was heard."""

    USED = "used"
    UNKNOWN = "unknown"
    TOO_OLD = "too_old"
    TOO_WEAK = "too_weak"
    OTHER_FLOOR = "other_floor"
    GATED = "gated"
    NO_FIX = "no_fix"


@dataclass(frozen=True, slots=True)
class CandidatePlace:
    """A place that the scan spoke for.

    Attributes
    ----------
    weight
        As matching gave it.
    seen_weight
        As the filter saw it, from where it expected the phone.
    """

    floor_id: str
    x_m: float
    y_m: float
    weight: float
    seen_weight: float


@dataclass(frozen=True, slots=True)
class Residual:
    """One transmitter of the scan.

    Attributes
    ----------
    key
        Its transmitter key; of several the one that the site knows.
    kind
        ``wifi`` or ``ble``.
    anchor_id
        The registered beacon that it is, in lateration.
    heard_dbm
        As it went into the fix: the strongest or the mean level of the scan's window.
    expected_dbm
        At the told place: of the fingerprints around it, or of the anchor's level model. None where
        neither knows it there.
    residual_db
        Heard less expected.
    """

    key: str
    kind: str
    anchor_id: str | None
    heard_dbm: float
    expected_dbm: float | None
    residual_db: float | None
    use: Use


@dataclass(frozen=True, slots=True)
class Gate:
    """How far the sighting was from the filter's prediction, and what it was let count.

    See `app.core.fusion.innovation.Innovation`.
    """

    distance_m: float
    nis: float
    inlier_probability: float | None


@dataclass(frozen=True, slots=True)
class FloorVote:
    """One floor: its share of the scan's vote (None: no vote) and its probability now."""

    floor_id: str
    vote_share: float | None
    probability: float | None


@dataclass(frozen=True, slots=True)
class BlamedAnchor:
    """An anchor that is more likely at fault than not; ``fault`` None: how cannot be told yet."""

    anchor_id: str
    fault: Fault | None


@dataclass(frozen=True, slots=True)
class MotionReason:
    """The motion mode, the evidence that decided it, and all the numbers there are.

    Attributes
    ----------
    since_step_s
        Time since the last step.
    acc_variance_m2ps4
        Running variance of the acceleration's norm.
    velocity_chi2
        Significance of the velocity that levels alone tell.
    """

    mode: MotionMode
    decided_by: MotionEvidence
    since_step_s: float | None
    acc_variance_m2ps4: float | None
    velocity_chi2: float | None


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why the latest output is what it is.

    Attributes
    ----------
    output
        What is explained: a point or the reason for none.
    means
        How the scan told the place, by lateration or fingerprints or both in one filter; None: it
        told none.
    scan_s
        When that scan was made; None before the first.
    candidates
        Heaviest first, as the filter saw them.
    transmitters
        All that were heard, loudest first.
    level_offset_db
        Median residual of those used: how much louder than the site expects this phone hears.
    gate
        None where there was nothing to predict from yet.
    faults
        The anchors that are held for dead, moved or duplicated, by id.
    """

    output: Output
    means: Method | None
    scan_s: float | None
    candidates: tuple[CandidatePlace, ...]
    transmitters: tuple[Residual, ...]
    level_offset_db: float | None
    gate: Gate | None
    floors: tuple[FloorVote, ...]
    motion: MotionReason
    faults: tuple[BlamedAnchor, ...] = ()
