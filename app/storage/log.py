"""The observation log: every acknowledged batch of every session, in the order of its arrival."""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from sqlalchemy import Connection, Select, delete, func, select, update

from app.core.engine import in_order
from app.core.session import (
    LoggedBatch,
    LogUnavailableError,
    SessionClock,
    SessionRecord,
    event_times,
)
from app.core.types import Observation
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.log_rows import (
    LOGGED,
    batch_values,
    clock_values,
    logged_batch,
    session_record,
    session_values,
    span,
)
from app.storage.tables import (
    DEVICES,
    OBSERVATION_BATCHES,
    QUARANTINED_SESSIONS,
    SESSIONS,
    SNAPSHOTS,
)
from app.storage.upsert import Values, insert_new

T = TypeVar("T")


class SqlObservationLog:
    """The log in the database.

    Parameters
    ----------
    limit_s
        How long a write may take before the phone is told to come back; None: as long as it takes.
    """

    def __init__(self, database: Database, limit_s: float | None = None) -> None:
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
        known = await self._write(partial(_append, batch_values(batch, clock)))
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


def _open_session(record: SessionRecord, connection: Connection) -> SessionRecord:
    device = {
        "id": record.device_id,
        "site_id": record.site_id,
        "first_seen_s": record.opened_s,
        "last_seen_s": record.opened_s,
    }
    insert_new(connection, DEVICES, device, DEVICES.c.id)
    insert_new(
        connection, SESSIONS, session_values(record), SESSIONS.c.device_id, SESSIONS.c.session
    )
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
    return logged_batch(connection.execute(query).one())


def _settle_clock(record: SessionRecord, connection: Connection) -> None:
    query = select(SESSIONS).where(SESSIONS.c.id == record.session_id)
    before = session_record(connection.execute(query).one()).clock
    settle = update(SESSIONS).where(SESSIONS.c.id == record.session_id)
    connection.execute(settle.values(clock_values(record.clock)))
    if not record.clock.keeps_times_of(before):
        _span_anew(record, connection)
        snapshot = delete(SNAPSHOTS).where(SNAPSHOTS.c.session_id == record.session_id)
        connection.execute(snapshot)


def _span_anew(record: SessionRecord, connection: Connection) -> None:
    for row in connection.execute(_batches_of(record.session_id)).all():
        spanned = span(tuple(event_times([logged_batch(row)], record.clock)))
        batches = OBSERVATION_BATCHES
        by_seq = update(batches).where(
            batches.c.session_id == record.session_id, batches.c.seq == row.seq
        )
        connection.execute(by_seq.values(spanned))


def _batches_of(session_id: str) -> Select[tuple[object, ...]]:
    batches = OBSERVATION_BATCHES
    return _batches().where(batches.c.session_id == session_id).order_by(batches.c.id)


def _batches() -> Select[tuple[object, ...]]:
    return select(*(OBSERVATION_BATCHES.c[name] for name in LOGGED))
