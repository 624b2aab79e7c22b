"""What a session leaves behind: its frozen clock and its logged batches. Values only.

A session is one uninterrupted use of one phone; the phone names it (``session`` when it posts).
"""

from dataclasses import dataclass

from app.core.types import Observation, TrackPoint


@dataclass(frozen=True, slots=True)
class SessionClock:
    """Map of the phone's clocks to event time, frozen at the session's first batch.

    event time = wall clock + ``offset_s``; wall clock = monotonic clock + ``mono_to_wall_s``.

    Attributes
    ----------
    recorded
        True for a replayed recording: recorded times are kept and no age limits apply.
    boot_id
        The phone's boot that the monotonic clock belongs to, if it told one.
    """

    recorded: bool = False
    offset_s: float = 0.0
    mono_to_wall_s: float | None = None
    boot_id: str | None = None


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
    """One acknowledged batch: immutable under ``(session_id, seq)``.

    Attributes
    ----------
    digest
        Of the batch's records as decoded (not of its bytes: a retry may differ in its send time).
    observations
        In event time, as the fold takes them.
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


@dataclass(frozen=True, slots=True)
class LastPoint:
    """Where a device was last known to be: the newest stored point of its newest session."""

    device_id: str
    session_id: str
    site_id: str
    point: TrackPoint


class LogUnavailableError(Exception):
    """The observation log could not be written in time; the phone keeps its batch and retries."""
