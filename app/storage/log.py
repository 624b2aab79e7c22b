"""The observation log: every acknowledged batch of every session, in the order of its arrival."""

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from sqlalchemy import Connection, Row, RowMapping, Select, bindparam, delete, func, select, update

from app.core.engine import in_order
from app.core.session import (
    LoggedBatch,
    LogUnavailableError,
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
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.tables import (
    DEVICES,
    OBSERVATION_BATCHES,
    QUARANTINED_SESSIONS,
    SESSIONS,
    SNAPSHOTS,
)
from app.storage.upsert import Values, insert_new

T = TypeVar("T")

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

# Batches rewritten by retention in one transaction: short enough that no phone waits for it.
PURGE_STRIDE = 64


class SqlObservationLog:
    """The log in the database.

    Parameters
    ----------
    limit_s
        How long a write may take before the phone is told to come back.
    """

    def __init__(self, database: Database, limit_s: float = 2.0) -> None:
        self._database = database
        self._limit_s = limit_s

    async def open_session(self, record: SessionRecord) -> SessionRecord:
        """Store a new session, or return the stored one of the same device and session name."""
        return await self._write(partial(_open_session, record))

    async def unfinished_sessions(self) -> list[SessionRecord]:
        """Return sessions whose final track has not been stored yet, oldest first."""
        query = select(SESSIONS).where(~SESSIONS.c.finished).order_by(SESSIONS.c.opened_s)
        return await self._database.read(
            lambda c: [session_record(row) for row in c.execute(query)]
        )

    async def settle_clock(self, record: SessionRecord) -> None:
        """Store the session's clock; if its event times are others now, forget the snapshot."""
        await self._write(partial(_settle_clock, record))

    async def append(self, batch: LoggedBatch, clock: SessionClock) -> LoggedBatch:
        """Make a batch durable and return it; of a known seq, return the stored batch.

        Raises
        ------
        LogUnavailableError
            If it could not be made durable within the limit.
        """
        known = await self._write(partial(_append, _batch_values(batch, clock)))
        return batch if known is None else known

    async def read(self, session_id: str, since_s: float | None = None) -> list[LoggedBatch]:
        """Return the batches that reach to event time ``since_s`` or beyond (None: all).

        Event times are those of the session's stored clock.
        """
        query = _batches_of(session_id)
        if since_s is not None:
            query = query.where(OBSERVATION_BATCHES.c.last_s >= since_s)
        return await self._database.read(lambda c: [logged_batch(row) for row in c.execute(query)])

    async def observations(self, session_id: str) -> list[Observation]:
        """Return what a session has observed, in event time and in order, each once."""

        def statement(connection: Connection) -> tuple[list[LoggedBatch], SessionClock]:
            session = connection.execute(select(SESSIONS).where(SESSIONS.c.id == session_id))
            batches = connection.execute(_batches_of(session_id))
            return [logged_batch(row) for row in batches], session_record(session.one()).clock

        batches, clock = await self._database.read(statement)
        return await asyncio.to_thread(lambda: in_order(event_times(batches, clock)))

    async def finish_session(self, session_id: str) -> None:
        """Mark the session's final track as stored; it is of one profile."""
        finish = update(SESSIONS).where(SESSIONS.c.id == session_id)
        finish = finish.values(finished=True, profile_since_s=None)
        await self._database.write(lambda c: c.execute(finish).close())

    async def reopen_session(self, session_id: str) -> None:
        """Mark the session unfinished: the phone came back and its track will change."""
        reopen = update(SESSIONS).where(SESSIONS.c.id == session_id).values(finished=False)
        forget = delete(QUARANTINED_SESSIONS).where(
            QUARANTINED_SESSIONS.c.session_id == session_id,
            QUARANTINED_SESSIONS.c.decided_s.is_(None),
        )

        def statement(connection: Connection) -> None:
            connection.execute(reopen)
            # It is not over: what it told so far is not all of it.
            connection.execute(forget)

        await self._write(statement)

    async def switch_profile(self, record: SessionRecord) -> None:
        """Store the session's profile, and since when it is on."""
        switch = update(SESSIONS).where(SESSIONS.c.id == record.session_id)
        switch = switch.values(profile=record.profile, profile_since_s=record.profile_since_s)
        await self._write(lambda c: c.execute(switch).close())

    async def _write(self, statement: Callable[[Connection], T]) -> T:
        try:
            return await self._database.write(statement, self._limit_s)
        except DatabaseUnavailableError as error:
            raise LogUnavailableError(str(error)) from error


def find_session(
    connection: Connection, device_id: str, session: str | None
) -> SessionRecord | None:
    """Return a device's session by the phone's name for it (None: the newest), if it is there."""
    query = select(SESSIONS).where(SESSIONS.c.device_id == device_id)
    if session is not None:
        query = query.where(SESSIONS.c.session == session)
    row = connection.execute(query.order_by(SESSIONS.c.opened_s.desc()).limit(1)).first()
    return None if row is None else session_record(row)


def logged_bytes(connection: Connection, session_id: str) -> int:
    """Return how large a session's observations are as stored."""
    batches = OBSERVATION_BATCHES
    size = select(func.sum(func.length(batches.c.payload)))
    return connection.execute(size.where(batches.c.session_id == session_id)).scalar() or 0


async def purge_imu(database: Database, before_s: float) -> int:
    """Remove raw IMU received before ``before_s`` from finished sessions; return batches changed.

    A session that is not finished keeps it: its final track is folded from the whole log.
    """
    return await database.write_in_strides(partial(_purge_imu_stride, before_s))


async def purge_observations(
    database: Database, site_id: str, before_s: float, over_s: float
) -> int:
    """Remove the batches of a site's finished sessions received before ``before_s``.

    Sessions opened at ``over_s`` or later may be opened again: of these the batches are emptied
    only, so that a late retry is still known. Returns how many were removed or emptied.
    """
    old = (
        select(OBSERVATION_BATCHES.c.id)
        .join(SESSIONS, SESSIONS.c.id == OBSERVATION_BATCHES.c.session_id)
        .where(SESSIONS.c.site_id == site_id, SESSIONS.c.finished)
        .where(OBSERVATION_BATCHES.c.received_s < before_s)
        .limit(PURGE_STRIDE)
    )
    removed = await database.write_in_strides(
        partial(_remove_stride, old.where(SESSIONS.c.opened_s < over_s))
    )
    emptied = await database.write_in_strides(
        partial(_empty_stride, old.where(OBSERVATION_BATCHES.c.last_s.is_not(None)))
    )
    return removed + emptied


def _purge_imu_stride(before_s: float, connection: Connection) -> int:
    batches = OBSERVATION_BATCHES
    query = (
        select(batches.c.id, batches.c.payload, batches.c.monotonic)
        .join(SESSIONS, SESSIONS.c.id == batches.c.session_id)
        .where(batches.c.has_imu, batches.c.received_s < before_s, SESSIONS.c.finished)
        .limit(PURGE_STRIDE)
    )
    purged = [_without_imu(row) for row in connection.execute(query).mappings()]
    if purged:
        by_id = update(batches).where(batches.c.id == bindparam("row_id"))
        connection.execute(by_id, purged)
    return len(purged)


def _without_imu(row: RowMapping) -> Values:
    """Return what is left of a batch; the span of its event times stays as wide as it was."""
    observations = OBSERVATIONS.decode(row["payload"])
    kept = [i for i, o in enumerate(observations) if not isinstance(o, ImuBlock)]
    flags = row["monotonic"]
    monotonic = flags and bytes(flags[i] for i in kept)
    payload = OBSERVATIONS.encode([observations[i] for i in kept])
    return {"row_id": row["id"], "payload": payload, "monotonic": monotonic, "has_imu": False}


def _remove_stride(stride: Select[tuple[int]], connection: Connection) -> int:
    removed = delete(OBSERVATION_BATCHES).where(OBSERVATION_BATCHES.c.id.in_(stride))
    return connection.execute(removed).rowcount


def _empty_stride(stride: Select[tuple[int]], connection: Connection) -> int:
    emptied = update(OBSERVATION_BATCHES).where(OBSERVATION_BATCHES.c.id.in_(stride))
    return connection.execute(emptied.values({**_content(()), **_span(())})).rowcount


def _open_session(record: SessionRecord, connection: Connection) -> SessionRecord:
    device = {
        "id": record.device_id,
        "site_id": record.site_id,
        "first_seen_s": record.opened_s,
        "last_seen_s": record.opened_s,
    }
    insert_new(connection, DEVICES, device, DEVICES.c.id)
    insert_new(connection, SESSIONS, _values(record), SESSIONS.c.device_id, SESSIONS.c.session)
    stored = find_session(connection, record.device_id, record.session)
    return record if stored is None else stored


def _append(values: Values, connection: Connection) -> LoggedBatch | None:
    """Store a batch; return the stored one instead if its seq is known."""
    batches = OBSERVATION_BATCHES
    if insert_new(connection, batches, values, batches.c.session_id, batches.c.seq):
        return None
    query = _batches().where(
        batches.c.session_id == values["session_id"], batches.c.seq == values["seq"]
    )
    return _batch(connection.execute(query).one())


def _settle_clock(record: SessionRecord, connection: Connection) -> None:
    query = select(SESSIONS).where(SESSIONS.c.id == record.session_id)
    before = session_record(connection.execute(query).one()).clock
    settle = update(SESSIONS).where(SESSIONS.c.id == record.session_id)
    connection.execute(settle.values(_clock_values(record.clock)))
    if not record.clock.keeps_times_of(before):
        _span_anew(record, connection)
        snapshot = delete(SNAPSHOTS).where(SNAPSHOTS.c.session_id == record.session_id)
        connection.execute(snapshot)


def _span_anew(record: SessionRecord, connection: Connection) -> None:
    for row in connection.execute(_batches_of(record.session_id)).all():
        span = _span(tuple(event_times([logged_batch(row)], record.clock)))
        batches = OBSERVATION_BATCHES
        by_seq = update(batches).where(
            batches.c.session_id == record.session_id, batches.c.seq == row.seq
        )
        connection.execute(by_seq.values(span))


def _batch_values(batch: LoggedBatch, clock: SessionClock) -> Values:
    return {
        "session_id": batch.session_id,
        "seq": batch.seq,
        "digest": batch.digest,
        "received_s": batch.received_s,
        "rejected": _REJECTIONS.encode(batch.rejected),
        "ignored": batch.ignored,
        **_content(batch.observations, batch.monotonic),
        **_span(tuple(event_times([batch], clock))),
    }


def _content(
    observations: Sequence[Observation], monotonic: tuple[bool, ...] | None = ()
) -> Values:
    """Return the columns that hold what a batch holds."""
    return {
        "has_imu": any(isinstance(o, ImuBlock) for o in observations),
        "payload": OBSERVATIONS.encode(observations),
        "monotonic": None if monotonic is None else bytes(monotonic),
    }


def _span(observations: Sequence[Observation]) -> Values:
    """Return the columns of the span that observations in event time speak of."""
    return {
        "first_s": min((o.time_s for o in observations), default=None),
        "last_s": max((event_time_s(o) for o in observations), default=None),
    }


def _batches_of(session_id: str) -> Select[tuple[object, ...]]:
    batches = OBSERVATION_BATCHES
    return _batches().where(batches.c.session_id == session_id).order_by(batches.c.id)


def _batches() -> Select[tuple[object, ...]]:
    return select(*(OBSERVATION_BATCHES.c[name] for name in LOGGED))


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


def _clock_values(clock: SessionClock) -> Values:
    return {
        "clock_recorded": clock.recorded,
        "clock_ahead_s": clock.ahead_s,
        "clock_mono_ahead_s": clock.mono_ahead_s,
        "clock_mono_to_wall_s": clock.mono_to_wall_s,
        "clock_mono_seq": clock.mono_seq,
        "clock_boot_id": clock.boot_id,
    }


def _values(record: SessionRecord) -> Values:
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
        **_clock_values(record.clock),
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
