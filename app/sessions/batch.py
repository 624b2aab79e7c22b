"""What the edge hands to a session and what it gets back; the ways a batch can be refused."""

from dataclasses import dataclass

from app.core.session import Rejection, Untimed
from app.core.types import BeaconTelemetry, Observation, Output


@dataclass(frozen=True, slots=True)
class ClockReport:
    """What the phone says of its clocks as it sends a batch, in seconds of each clock."""

    recorded: bool = False
    sent_s: float | None = None
    mono_s: float | None = None
    boot_id: str | None = None


@dataclass(frozen=True, slots=True)
class IncomingRecord:
    """One valid record by its place in the batch, timed by the phone's wall or monotonic clock.

    ``telemetry`` is what the beacons of its scan told of themselves; it is not folded.
    """

    index: int
    observation: Observation
    monotonic: bool = False
    telemetry: tuple[BeaconTelemetry, ...] = ()


@dataclass(frozen=True, slots=True)
class IncomingBatch:
    """One decoded body; ``session`` is the phone's name for the session.

    ``site_id`` and ``named_profile``, which the phone asks for, count when the batch opens its
    session. ``profile`` is the device's, else the site's: a session that named none follows it.
    ``rejected`` and ``ignored`` are what the edge has sorted out already.
    """

    device_id: str
    session: str
    seq: int
    digest: bytes
    site_id: str
    profile: str
    received_s: float
    clock: ClockReport
    records: tuple[IncomingRecord, ...]
    rejected: tuple[Rejection, ...] = ()
    ignored: int = 0
    named_profile: str | None = None


@dataclass(frozen=True, slots=True)
class Submitted:
    """The answer to a durable batch.

    ``output`` is the session's position (or its absence) at the latest observation, None while the
    session has observed nothing; ``duplicate`` tells a batch that was known already. ``waiting`` of
    the accepted records count as soon as a batch of the session tells the monotonic clock.
    ``observations`` are those that it made durable, in the order of its records and in event time,
    or why one has none by now.
    """

    session_id: str
    accepted: int
    rejected: tuple[Rejection, ...]
    ignored: int
    output: Output | None
    duplicate: bool
    waiting: int = 0
    observations: tuple[Observation | Untimed, ...] = ()


class BatchConflictError(Exception):
    """The sequence number is taken by a batch with other records."""


class MailboxFullError(Exception):
    """Too many batches of the device are waiting; the phone shall try again later."""

    def __init__(self, retry_after_s: float) -> None:
        super().__init__(f"mailbox full, retry after {retry_after_s} s")
        self.retry_after_s = retry_after_s


class ClockChangedError(Exception):
    """The batch tells of another boot, clock mode or site than its session; open a new session."""


class SessionOverError(ClockChangedError):
    """The session was finished and is too old to be opened again; open a new session."""


class UnknownSiteError(Exception):
    """The session's site does not exist (any more)."""
