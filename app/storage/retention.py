"""Retention: what is removed from the observation log when its time is over."""

from functools import partial

from sqlalchemy import Connection, RowMapping, Select, bindparam, delete, select, update

from app.core.types import ImuBlock
from app.storage.database import Database
from app.storage.log_rows import OBSERVATIONS, content, span
from app.storage.tables import OBSERVATION_BATCHES, SESSIONS
from app.storage.upsert import Values

# Batches rewritten by retention in one transaction: short enough that no phone waits for it.
PURGE_STRIDE = 64


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
    return connection.execute(emptied.values({**content(()), **span(())})).rowcount
