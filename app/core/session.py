"""What a session leaves behind: its clock and its logged batches, and the event times they make.

A session is one uninterrupted use of one phone; the phone names it (``session`` when it posts).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

from app.core.types import ImuBlock, Observation, Pedometer, TrackPoint

# Phones keep time by network to well under this; what is left below is the way of the message.
CLOCK_TOLERANCE_S = 2.0
# A live phone keeps what it could not send for a day at most.
MAX_AGE_S = 24 * 3600.0
# Room for an offset that was estimated on a slow connection.
MAX_AHEAD_S = 300.0
# Shifted times are rounded to a microsecond: the last bits of a sum of clock readings would tell
# which batch told the clocks, and with them the track.
_TIME_DIGITS = 6


@dataclass(frozen=True, slots=True)
class SessionClock:
    """Map of the phone's clocks to event time, as its batches tell it together in any order.

    event time = wall clock + ``offset_s``; wall clock = monotonic clock + ``mono_to_wall_s``.

    Attributes
    ----------
    recorded
        True for a replayed recording: recorded times are kept and no age limits apply.
    ahead_s, mono_ahead_s
        How far the server's clock is ahead of the phone's wall and monotonic clocks, by the message
        of the session's first minute that was under way for the shortest time; None: not told.
    mono_to_wall_s, mono_seq
        As the batch of the lowest seq told it, and which that was.
    boot_id
        The phone's boot that the monotonic clock belongs to, if it told one.
    """

    recorded: bool = False
    ahead_s: float | None = None
    mono_ahead_s: float | None = None
    mono_to_wall_s: float | None = None
    mono_seq: int | None = None
    boot_id: str | None = None

    @property
    def offset_s(self) -> float:
        """Return what sets the phone's wall clock right: 0 unless it is off beyond tolerance.

        By way of the monotonic clock where it is told: the wall clock may be set meanwhile.
        """
        ahead_s = self.ahead_s
        if self.mono_ahead_s is not None and self.mono_to_wall_s is not None:
            ahead_s = self.mono_ahead_s - self.mono_to_wall_s
        if self.recorded or ahead_s is None or abs(ahead_s) <= CLOCK_TOLERANCE_S:
            return 0.0
        return ahead_s

    def keeps_times_of(self, other: "SessionClock") -> bool:
        """Tell whether both clocks make the same event times."""
        return (self.offset_s, self.mono_to_wall_s) == (other.offset_s, other.mono_to_wall_s)


class Untimed(StrEnum):
    """Why an observation has no event time."""

    NO_CLOCK = "no_clock"
    TOO_OLD = "too_old"
    IN_FUTURE = "in_future"


@dataclass(frozen=True, slots=True)
class SessionRecord:
    """A session as it was opened; ``session_id`` is the server's name, ``session`` the phone's.

    Attributes
    ----------
    profile
        With which all of it is folded.
    profile_named
        Whether the phone named the profile; if not, it is that of the device or of its site, and
        follows when they change it.
    profile_since_s
        Event time of the last such change: points before it stay as they were told with the profile
        of then, until the session ends. None: there was no change.
    """

    session_id: str
    device_id: str
    session: str
    site_id: str
    profile: str
    clock: SessionClock
    opened_s: float
    finished: bool = False
    profile_named: bool = False
    profile_since_s: float | None = None


@dataclass(frozen=True, slots=True)
class Rejection:
    """A record that was not taken: its index in the batch, a stable code, a pointer and words."""

    index: int
    code: str
    pointer: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LoggedBatch:
    """One acknowledged batch as the phone told it: immutable under ``(session_id, seq)``.

    Attributes
    ----------
    digest
        Of the batch's records as decoded (not of its bytes: a retry may differ in its send time).
    observations
        In the phone's own times; `event_times` makes event times of them.
    monotonic
        For each observation whether it is timed by the monotonic clock; empty: none is. None: the
        observations are in event time already, as all logs were before the first of these.
    rejected, ignored
        The reply's remainder, so that a retry gets the same answer.
    """

    session_id: str
    seq: int
    digest: bytes
    received_s: float
    observations: tuple[Observation, ...]
    rejected: tuple[Rejection, ...] = ()
    ignored: int = 0
    monotonic: tuple[bool, ...] | None = ()

    @property
    def monotonic_count(self) -> int:
        """Return how many observations are timed by the monotonic clock."""
        return sum(self.monotonic or ())


@dataclass(frozen=True, slots=True)
class LastPoint:
    """Where a device was last known to be: the newest stored point of its newest session."""

    device_id: str
    session_id: str
    site_id: str
    point: TrackPoint


class LogUnavailableError(Exception):
    """The observation log could not be written in time; the phone keeps its batch and retries."""


def event_time_s(observation: Observation) -> float:
    """Return the time of the last instant that the observation speaks of."""
    if isinstance(observation, ImuBlock):
        return observation.time_s + (len(observation.acc_mps2) - 1) / observation.rate_hz
    return observation.time_s


def event_times(batches: Iterable[LoggedBatch], clock: SessionClock) -> Iterator[Observation]:
    """Yield the observations of logged batches in event time.

    Left out is what the clock gives none: timed by a monotonic clock that nobody has told yet, or
    beyond the age limits.
    """
    for batch in batches:
        for timed in each_in_event_time(batch, clock):
            if not isinstance(timed, Untimed):
                yield timed


def each_in_event_time(batch: LoggedBatch, clock: SessionClock) -> Iterator[Observation | Untimed]:
    """Yield each observation of a logged batch in event time, or why it has none."""
    if batch.monotonic is None:
        yield from batch.observations
        return
    monotonic = batch.monotonic or (False,) * len(batch.observations)
    for observation, by_mono in zip(batch.observations, monotonic, strict=True):
        yield in_event_time(observation, clock, batch.received_s, monotonic=by_mono)


def in_event_time(
    observation: Observation, clock: SessionClock, received_s: float, *, monotonic: bool
) -> Observation | Untimed:
    """Return an observation of the phone's clocks in event time, or why it has none."""
    shift_s = clock.offset_s
    if monotonic:
        if clock.mono_to_wall_s is None:
            return Untimed.NO_CLOCK
        shift_s += clock.mono_to_wall_s
    timed = _shifted(observation, shift_s)
    if clock.recorded:
        return timed
    if timed.time_s < received_s - MAX_AGE_S:
        return Untimed.TOO_OLD
    if event_time_s(timed) > received_s + MAX_AHEAD_S:
        return Untimed.IN_FUTURE
    return timed


def _shifted(observation: Observation, shift_s: float) -> Observation:
    if shift_s == 0.0:
        return observation
    time_s = round(observation.time_s + shift_s, _TIME_DIGITS)
    if isinstance(observation, Pedometer):
        begin_s = round(observation.begin_s + shift_s, _TIME_DIGITS)
        return replace(observation, begin_s=begin_s, time_s=time_s)
    return replace(observation, time_s=time_s)
