"""From a phone's clocks to event time, by a map that is frozen at the session's first batch."""

from dataclasses import replace

from app.core.engine import event_time_s
from app.core.session import Rejection, SessionClock
from app.core.types import Observation, Pedometer
from app.sessions.batch import ClockReport, IncomingBatch, IncomingRecord

# Phones keep time by network to well under this; what is left below is the way of the message.
CLOCK_TOLERANCE_S = 2.0
# A live phone keeps what it could not send for a day at most.
MAX_AGE_S = 24 * 3600.0
# Room for an offset that was estimated on a slow connection.
MAX_AHEAD_S = 300.0
# Shifted times are rounded to a microsecond: the last bits of a sum of clock readings would tell
# which batch was the first, and with them the track.
_TIME_DIGITS = 6


def freeze_clock(report: ClockReport, received_s: float) -> SessionClock:
    """Return the session's clock as its first batch tells it.

    A recording keeps its times; a live phone's wall clock is set right if it is off by more than
    the tolerance.
    """
    offset_s = 0.0
    if not report.recorded and report.sent_s is not None:
        difference_s = received_s - report.sent_s
        offset_s = difference_s if abs(difference_s) > CLOCK_TOLERANCE_S else 0.0
    mono_to_wall_s = None
    if report.sent_s is not None and report.mono_s is not None:
        mono_to_wall_s = report.sent_s - report.mono_s
    return SessionClock(report.recorded, offset_s, mono_to_wall_s, report.boot_id)


def is_same_clock(clock: SessionClock, report: ClockReport) -> bool:
    """Tell whether a later batch speaks of the clocks that the session was opened with."""
    if clock.recorded != report.recorded:
        return False
    return clock.boot_id is None or report.boot_id is None or clock.boot_id == report.boot_id


def observations_in_event_time(
    batch: IncomingBatch, clock: SessionClock
) -> tuple[tuple[Observation, ...], tuple[Rejection, ...]]:
    """Return the batch's observations in event time, and all its rejections by index."""
    observations: list[Observation] = []
    rejected = list(batch.rejected)
    for record in batch.records:
        result = _in_event_time(record, clock, batch.received_s)
        if isinstance(result, Rejection):
            rejected.append(result)
        else:
            observations.append(result)
    return tuple(observations), tuple(sorted(rejected, key=lambda r: r.index))


def _in_event_time(
    record: IncomingRecord, clock: SessionClock, received_s: float
) -> Observation | Rejection:
    shift_s = clock.offset_s
    if record.monotonic:
        if clock.mono_to_wall_s is None:
            detail = "the session's first batch told no monotonic time in its clock block"
            return Rejection(record.index, "no_clock", detail=detail)
        shift_s += clock.mono_to_wall_s
    observation = _shifted(record.observation, shift_s)
    if clock.recorded:
        return observation
    if observation.time_s < received_s - MAX_AGE_S:
        return Rejection(record.index, "too_old", detail="observed more than 24 h ago")
    if event_time_s(observation) > received_s + MAX_AHEAD_S:
        return Rejection(record.index, "in_future", detail="more than 5 min ahead of the server")
    return observation


def _shifted(observation: Observation, shift_s: float) -> Observation:
    if shift_s == 0.0:
        return observation
    time_s = round(observation.time_s + shift_s, _TIME_DIGITS)
    if isinstance(observation, Pedometer):
        begin_s = round(observation.begin_s + shift_s, _TIME_DIGITS)
        return replace(observation, begin_s=begin_s, time_s=time_s)
    return replace(observation, time_s=time_s)
