"""A session's clock as its batches tell it, and what a batch may say by it."""

from dataclasses import replace

from app.core.session import LoggedBatch, Rejection, SessionClock, Untimed, in_event_time
from app.sessions.batch import ClockReport, IncomingBatch, IncomingRecord

# Messages of this first span of a session tell how far the phone's wall clock is off: the least
# delayed of a handful is as good as the best of all, and a clock set right later moves nothing.
SETTLING_S = 60.0
# A record by a monotonic clock that nobody has told yet waits for its session's other batches this
# long: several retries of the one that is under way.
CLOCK_WAIT_S = 60.0

_DETAILS = {
    Untimed.NO_CLOCK: "no batch of the session tells sent_ms and mono_ms in its clock block",
    Untimed.TOO_OLD: "observed more than 24 h ago",
    Untimed.IN_FUTURE: "more than 5 min ahead of the server",
}


def settled_clock(clock: SessionClock, batch: IncomingBatch, opened_s: float) -> SessionClock:
    """Return the session's clock with what a batch tells of it; the order of batches is all one.

    How the monotonic clock maps to the wall clock is what the batch of the lowest seq told: its two
    readings are some milliseconds apart, other ones in each batch. How far the phone's clocks are
    off is the least that a batch of the first minute told: a message is late, never early.
    """
    report = batch.clock
    settled = replace(clock, boot_id=clock.boot_id or report.boot_id)
    if report.sent_s is None:
        return settled
    if batch.received_s - opened_s <= SETTLING_S:
        settled = replace(settled, ahead_s=_least(clock.ahead_s, batch.received_s - report.sent_s))
    if report.mono_s is None:
        return settled
    if batch.received_s - opened_s <= SETTLING_S:
        mono_ahead_s = _least(clock.mono_ahead_s, batch.received_s - report.mono_s)
        settled = replace(settled, mono_ahead_s=mono_ahead_s)
    if clock.mono_seq is None or batch.seq < clock.mono_seq:
        mono_to_wall_s = report.sent_s - report.mono_s
        settled = replace(settled, mono_to_wall_s=mono_to_wall_s, mono_seq=batch.seq)
    return settled


def _least(known_s: float | None, told_s: float) -> float:
    return told_s if known_s is None else min(known_s, told_s)


def is_same_clock(clock: SessionClock, report: ClockReport) -> bool:
    """Tell whether a later batch speaks of the clocks that the session was opened with."""
    if clock.recorded != report.recorded:
        return False
    return clock.boot_id is None or report.boot_id is None or clock.boot_id == report.boot_id


def logged_batch(
    batch: IncomingBatch, session_id: str, clock: SessionClock, opened_s: float
) -> LoggedBatch:
    """Return what is logged of a batch: the records that are taken, and all rejections by index."""
    taken: list[IncomingRecord] = []
    rejected = list(batch.rejected)
    may_wait = batch.received_s - opened_s <= CLOCK_WAIT_S
    for record in batch.records:
        why = _refused(record, clock, batch.received_s)
        if why is None or (why is Untimed.NO_CLOCK and may_wait):
            taken.append(record)
        else:
            rejected.append(Rejection(record.index, why.value, detail=_DETAILS[why]))
    monotonic = tuple(record.monotonic for record in taken)
    return LoggedBatch(
        session_id=session_id,
        seq=batch.seq,
        digest=batch.digest,
        received_s=batch.received_s,
        observations=tuple(record.observation for record in taken),
        rejected=tuple(sorted(rejected, key=lambda r: r.index)),
        ignored=batch.ignored,
        monotonic=monotonic if any(monotonic) else (),
    )


def _refused(record: IncomingRecord, clock: SessionClock, received_s: float) -> Untimed | None:
    timed = in_event_time(record.observation, clock, received_s, monotonic=record.monotonic)
    return timed if isinstance(timed, Untimed) else None
