"""Rows of the observation log and of sessions, to and from what they store."""

from collections.abc import Sequence

from sqlalchemy import Row

from app.core.session import (
    LoggedBatch,
    Rejection,
    SessionClock,
    SessionRecord,
    event_time_s,
    event_times,
)
from app.core.types import (
    Barometer,
    BleScan,
    ImuBlock,
    Observation,
    Pedometer,
    Steps,
    Truth,
    WifiScan,
)
from app.storage.codec import VariantCodec
from app.storage.upsert import Values

OBSERVATIONS: VariantCodec[Observation] = VariantCodec(
    {
        "wifi": WifiScan,
        "ble": BleScan,
        "steps": Steps,
        "pedometer": Pedometer,
        "imu": ImuBlock,
        "baro": Barometer,
        "truth": Truth,
    }
)
_REJECTIONS = VariantCodec({"rejection": Rejection})

LOGGED = (
    "session_id",
    "seq",
    "digest",
    "received_s",
    "payload",
    "rejected",
    "ignored",
    "monotonic",
)
"""Columns of a batch that `logged_batch` reads."""

CLOCK = (
    *("clock_recorded", "clock_ahead_s", "clock_mono_ahead_s"),
    *("clock_mono_to_wall_s", "clock_mono_seq", "clock_boot_id"),
)
"""Columns of a session that `session_clock` reads."""


def batch_values(batch: LoggedBatch, clock: SessionClock) -> Values:
    """Return a batch as the columns of its row."""
    return {
        "session_id": batch.session_id,
        "seq": batch.seq,
        "digest": batch.digest,
        "received_s": batch.received_s,
        "rejected": _REJECTIONS.encode(batch.rejected),
        "ignored": batch.ignored,
        **content(batch.observations, batch.monotonic),
        **span(tuple(event_times([batch], clock))),
    }


def content(observations: Sequence[Observation], monotonic: tuple[bool, ...] | None = ()) -> Values:
    """Return the columns that hold what a batch holds."""
    return {
        "has_imu": any(isinstance(o, ImuBlock) for o in observations),
        "payload": OBSERVATIONS.encode(observations),
        "monotonic": None if monotonic is None else bytes(monotonic),
    }


def span(observations: Sequence[Observation]) -> Values:
    """Return the columns of the span that observations in event time speak of."""
    return {
        "first_s": min((o.time_s for o in observations), default=None),
        "last_s": max((event_time_s(o) for o in observations), default=None),
    }


def logged_batch(row: Row[tuple[object, ...]]) -> LoggedBatch:
    """Return a row that has the columns `LOGGED` as what they store."""
    return LoggedBatch(
        session_id=row.session_id,
        seq=row.seq,
        digest=row.digest,
        received_s=row.received_s,
        observations=OBSERVATIONS.decode(row.payload),
        rejected=_REJECTIONS.decode(row.rejected),
        ignored=row.ignored,
        monotonic=None if row.monotonic is None else tuple(map(bool, row.monotonic)),
    )


def clock_values(clock: SessionClock) -> Values:
    """Return a session's clock as the columns `CLOCK`."""
    return {
        "clock_recorded": clock.recorded,
        "clock_ahead_s": clock.ahead_s,
        "clock_mono_ahead_s": clock.mono_ahead_s,
        "clock_mono_to_wall_s": clock.mono_to_wall_s,
        "clock_mono_seq": clock.mono_seq,
        "clock_boot_id": clock.boot_id,
    }


def session_values(record: SessionRecord) -> Values:
    """Return a session as the columns of its row."""
    return {
        "id": record.session_id,
        "device_id": record.device_id,
        "session": record.session,
        "site_id": record.site_id,
        "profile": record.profile,
        "profile_named": record.profile_named,
        "profile_since_s": record.profile_since_s,
        "opened_s": record.opened_s,
        "finished": record.finished,
        **clock_values(record.clock),
    }


def session_record(row: Row[tuple[object, ...]]) -> SessionRecord:
    """Return a row of the sessions' table as what it stores."""
    return SessionRecord(
        session_id=row.id,
        device_id=row.device_id,
        session=row.session,
        site_id=row.site_id,
        profile=row.profile,
        clock=session_clock(row),
        opened_s=row.opened_s,
        finished=row.finished,
        profile_named=row.profile_named,
        profile_since_s=row.profile_since_s,
    )


def session_clock(row: Row[tuple[object, ...]]) -> SessionClock:
    """Return a row that has the columns `CLOCK` as what they store."""
    return SessionClock(
        recorded=row.clock_recorded,
        ahead_s=row.clock_ahead_s,
        mono_ahead_s=row.clock_mono_ahead_s,
        mono_to_wall_s=row.clock_mono_to_wall_s,
        mono_seq=row.clock_mono_seq,
        boot_id=row.clock_boot_id,
    )
