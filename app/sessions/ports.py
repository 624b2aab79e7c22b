"""What live sessions need of the world; storage and main provide it, tests too."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from app.core import engine
from app.core.engine import Explanation, SessionState
from app.core.params import Params
from app.core.session import (
    LastPoint,
    LoggedBatch,
    LogUnavailableError,
    SessionClock,
    SessionRecord,
)
from app.core.site import SiteModel
from app.core.types import Observation, Output, TrackPoint

__all__ = [
    "Clock",
    "Fold",
    "LogUnavailableError",
    "ObservationLog",
    "SessionPorts",
    "SiteSource",
    "SnapshotStore",
    "TrackStore",
]


class Clock(Protocol):
    """The only source of the present time."""

    def now_s(self) -> float:
        """Return seconds since the Unix epoch."""
        ...


class Fold(Protocol):
    """What folds a session's observations: `app.core.engine`."""

    def start(self) -> SessionState:
        """Return the state of a session that has seen nothing yet."""
        ...

    def advance(
        self, state: SessionState, observation: Observation, site: SiteModel, params: Params
    ) -> tuple[SessionState, tuple[Output, ...]]:
        """Fold one observation; return the new state and one output per whole second passed."""
        ...

    def finish(self, state: SessionState, site: SiteModel, params: Params) -> tuple[Output, ...]:
        """Return what the track would end with if nothing more came."""
        ...

    def explained(self, state: SessionState, site: SiteModel, params: Params) -> Explanation | None:
        """Return why the last output of `finish` is what it is; None where there is none."""
        ...

    def smoothed(
        self, observations: Iterable[Observation], site: SiteModel, params: Params
    ) -> tuple[TrackPoint, ...]:
        """Return the final track of all observations of a session, in order."""
        ...


class SiteSource(Protocol):
    """Current snapshots of sites."""

    def current(self, site_id: str) -> SiteModel | None:
        """Return the site as it is now, None if there is no such site."""
        ...

    def params(self, site_id: str, profile: str) -> Params:
        """Return the parameters of a profile at a site."""
        ...


class ObservationLog(Protocol):
    """The durable record of everything acknowledged."""

    async def open_session(self, record: SessionRecord) -> SessionRecord:
        """Store a new session, or return the stored one of the same device and session name."""
        ...

    async def unfinished_sessions(self) -> list[SessionRecord]:
        """Return sessions whose final track has not been stored yet."""
        ...

    async def settle_clock(self, record: SessionRecord) -> None:
        """Store the session's clock; if its event times are others now, forget the snapshot."""
        ...

    async def append(self, batch: LoggedBatch, clock: SessionClock) -> LoggedBatch:
        """Make a batch durable (group commit) and return it; of a known seq, the stored batch.

        A new batch comes back as the very object that was passed. Of another object the caller
        compares digests: an equal one is a retry, another one a conflict.

        Raises
        ------
        LogUnavailableError
            If it could not be made durable within the limit (2 s).
        """
        ...

    async def read(self, session_id: str, since_s: float | None = None) -> list[LoggedBatch]:
        """Return the batches with an observation at or after event time ``since_s`` (None: all).

        Event times are those of the session's stored clock.
        """
        ...

    async def finish_session(self, session_id: str) -> None:
        """Mark the session's final track as stored."""
        ...

    async def switch_profile(self, record: SessionRecord) -> None:
        """Store the session's profile, and since when it is on."""
        ...

    async def reopen_session(self, session_id: str) -> None:
        """Mark the session unfinished: the phone came back and its track will change."""
        ...


class SnapshotStore(Protocol):
    """Checkpoints of running sessions, written in order with the points of tracks."""

    async def save(self, session_id: str, profile: str, state: SessionState) -> None:
        """Replace the session's snapshot; `LogUnavailableError` if that took too long."""
        ...

    async def load(self, session_id: str, profile: str) -> SessionState | None:
        """Return the session's snapshot if there is one that was folded with this profile."""
        ...


class TrackStore(Protocol):
    """Where whole-second track points of sessions are stored, in the order of the calls."""

    def write(self, session_id: str, points: Sequence[TrackPoint]) -> None:
        """Queue points; a point of the same session and time replaces the stored one."""
        ...

    def replace_from(self, session_id: str, from_s: float, points: Sequence[TrackPoint]) -> None:
        """Queue the removal of the session's points at or after ``from_s``, then these points."""
        ...

    async def flush(self) -> None:
        """Wait until everything queued so far is stored."""
        ...

    async def last_points(self) -> list[LastPoint]:
        """Return where every device with a stored track was last known to be."""
        ...


@dataclass(frozen=True, slots=True)
class SessionPorts:
    """Where a session reads, folds and writes."""

    log: ObservationLog
    snapshots: SnapshotStore
    tracks: TrackStore
    fold: Fold = engine
