"""The state of one session's fold."""

from dataclasses import dataclass, field
from typing import TypeAlias

from app.core.engine.order import OrderKey
from app.core.fingerprint.level_offset import LevelOffset
from app.core.fingerprint.query import Advertisement
from app.core.fusion.blending import BlendedMotion
from app.core.fusion.particles import Particles
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.scheduled import ScheduledMemory
from app.core.fusion.sighting import Sighting
from app.core.lateration.faults import Fault, LogOdds
from app.core.lateration.outside import Outside
from app.core.lateration.posterior import PhoneOffset
from app.core.motion.mode import MotionState
from app.core.motion.steps import StepDetector
from app.core.radio.level_smoothing import LevelMemory
from app.core.radio.windows import Window
from app.core.types import BleScan, FloatArray, Method, NoFixReason, Used, WifiScan

Track: TypeAlias = Particles | PlanarTrack
"""State of a profile's filter; a session keeps to one kind."""

Memory: TypeAlias = BlendedMotion | LevelMemory | ScheduledMemory | None
"""What a published profile remembers beside its track; a union of their own dataclasses."""


@dataclass(frozen=True, slots=True)
class Stride:
    """A step with its length, waiting for its time or taken.

    ``heading_rad`` is where the phone pointed on the plan (nan: unknown); ``seconds`` how long the
    step took.
    """

    time_s: float
    length_m: float
    heading_rad: float
    seconds: float


@dataclass(frozen=True)
class Evidence:
    """What the latest observation brought to the filter, in this order.

    ``strides`` whose time had come, ``drift_m2`` of motion that nothing showed, a ``sighting`` and
    the ``means`` by which it was made;
    ``left_out`` are the anchors that it does not rest on, by id, each with its fault (None: that
    cannot be told).
    """

    strides: tuple[Stride, ...] = ()
    drift_m2: float = 0.0
    sighting: Sighting | None = None
    means: Method | None = None
    left_out: dict[str, Fault | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """The scan that told the place last, and what the filter believed before and after it.

    For explanations, which are made on demand: these are references to values that were there
    anyway, and cost nothing. A scan that told nothing takes this place when there is no newer one
    that did.

    Attributes
    ----------
    scan, heard, window
        What was scanned; the advertisements (unless it was laterated) and the anchors' levels of
        that time.
    before, after
        The filter before and after; None: there was no fix yet.
    evidence
        What it brought.
    means
        How it told the place; None: it told none.
    """

    scan: BleScan | WifiScan
    heard: tuple[Advertisement, ...]
    window: Window
    before: Track | None
    after: Track | None
    evidence: Evidence
    means: Method | None


@dataclass(frozen=True, slots=True)
class LaterationMemory:
    """What lateration learned in a session.

    Attributes
    ----------
    told_s
        When it last told a place; None before.
    offset
        What is known of the phone's level offset; None: what the parameters say.
    fault_log_odds
        By anchor that may be at fault, see `app.core.lateration.faults`.
    outside
        Whether the phone is outside the plan; None before its first levels.
    """

    told_s: float | None = None
    offset: PhoneOffset | None = None
    fault_log_odds: dict[str, LogOdds] = field(default_factory=dict)
    outside: Outside | None = None


@dataclass(frozen=True)
class SessionState:
    """Everything a session remembers; immutable, so any older state is a checkpoint.

    Without slots, for `changed`; so is what it holds of what often changes.

    Attributes
    ----------
    last_key
        Order key of the last observation folded; None before the first.
    latest_s
        The latest instant any folded observation speaks of.
    now_s
        Event time the fold has advanced to; strides and whole seconds up to it are done.
    detector, motion
        Memories of the step detector and of motion-mode detection.
    pending
        Strides found in an inertial block that lie after ``now_s``.
    phone_steps_s
        When the phone last told steps itself: its own detector is believed before ours.
    began_s, scanned_s, wifi_s
        When the session's first observation was made; when anything, and Wi-Fi, was last scanned.
    heard, window, walked
        Recent advertisements for fingerprints, recent levels of anchors for lateration, recent
        strides.
    level_offset
        What the phone hears more than the survey's phones, None before the first match.
    lateration
        What the levels of anchors have told of phone and anchors.
    track
        The filter, None before the first fix.
    memory
        What a published profile remembers beside it.
    floor_belief : (floors,)
        Probability of each floor, None before the first vote.
    stride
        The last stride taken, turned by the filter's heading bias.
    told_s
        When the position was last told by a scan; None before.
    sighted_m2
        Variance per axis of that scan's candidates about the truth; None where fixes have none.
    evidence
        What the latest observation brought; smoothing is made of it.
    told
        The scan that explanations are made of; None before the first.
    method, used, reason
        Of the newest point: how it came about, on what it rests; why there is none.
    """

    last_key: OrderKey | None = None
    latest_s: float | None = None
    now_s: float | None = None
    detector: StepDetector = field(default_factory=StepDetector)
    motion: MotionState = field(default_factory=MotionState)
    pending: tuple[Stride, ...] = ()
    phone_steps_s: float | None = None
    began_s: float | None = None
    scanned_s: float | None = None
    wifi_s: float | None = None
    heard: tuple[Advertisement, ...] = ()
    window: Window = field(default_factory=Window)
    level_offset: LevelOffset | None = None
    walked: tuple[Stride, ...] = ()
    lateration: LaterationMemory = field(default_factory=LaterationMemory)
    track: Track | None = None
    memory: Memory = None
    floor_belief: FloatArray | None = None
    stride: Stride | None = None
    told_s: float | None = None
    sighted_m2: float | None = None
    evidence: Evidence = field(default_factory=Evidence)
    told: Told | None = None
    method: Method = Method.DEAD_RECKONING
    used: Used = field(default_factory=Used)
    reason: NoFixReason = NoFixReason.NOT_STARTED


def start() -> SessionState:
    """Return the state of a session that has seen nothing yet."""
    return SessionState()
