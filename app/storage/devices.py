"""Devices as stored: the phones that have posted something, and who carries them."""

from dataclasses import dataclass

from sqlalchemy import Connection, RowMapping, Select, delete, func, select

from app.storage.rows import update_row
from app.storage.tables import DEVICES, OBSERVATION_BATCHES, SESSIONS
from app.storage.tokens import delete_tokens_of_device


@dataclass(frozen=True, slots=True)
class StoredDevice:
    """One phone.

    Attributes
    ----------
    site_id
        Where it was last, None if the site is gone.
    last_seen_s
        When its newest batch came.
    profile
        Of its sessions that name none; None: the site's.
    level_offset_db
        How much louder than others it hears; taken off every level it reports.
    """

    device_id: str
    site_id: str | None = None
    name: str = ""
    person: str | None = None
    platform: str | None = None
    model: str | None = None
    profile: str | None = None
    level_offset_db: float = 0.0
    first_seen_s: float | None = None
    last_seen_s: float | None = None
    row_version: int = 1


def list_devices(
    connection: Connection, *, site_id: str | None, after: str | None, limit: int
) -> list[StoredDevice]:
    """Return up to ``limit + 1`` devices by id, of one site or all."""
    query = _devices().order_by(DEVICES.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(DEVICES.c.site_id == site_id)
    if after is not None:
        query = query.where(DEVICES.c.id > after)
    return [_device(row) for row in connection.execute(query).mappings()]


def get_device(connection: Connection, device_id: str) -> StoredDevice | None:
    """Return a device, None if there is none of this id."""
    query = _devices().where(DEVICES.c.id == device_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _device(row)


def update_device(connection: Connection, device: StoredDevice) -> int:
    """Store what an admin may edit of a device read as ``row_version``; return the new version."""
    return update_row(
        connection,
        DEVICES,
        device.device_id,
        device.row_version,
        {
            "name": device.name,
            "person": device.person,
            "level_offset_db": device.level_offset_db,
            "profile": device.profile,
        },
    )


def erase_device(connection: Connection, device_id: str) -> None:
    """Remove a device with everything it posted, its tracks and its own tokens."""
    delete_tokens_of_device(connection, device_id)
    connection.execute(delete(DEVICES).where(DEVICES.c.id == device_id))


def sessions_of_device(connection: Connection, device_id: str) -> dict[str, tuple[str, str]]:
    """Return the site of every session of a device, and the phone's name for the session."""
    query = select(SESSIONS.c.id, SESSIONS.c.site_id, SESSIONS.c.session)
    rows = connection.execute(query.where(SESSIONS.c.device_id == device_id))
    return {row.id: (row.site_id, row.session) for row in rows}


def _devices() -> Select[tuple[object, ...]]:
    """Select devices; their column of that name is written once a minute only."""
    newest_session = (
        select(SESSIONS.c.id)
        .where(SESSIONS.c.device_id == DEVICES.c.id)
        .order_by(SESSIONS.c.opened_s.desc())
        .limit(1)
        .correlate(DEVICES)
        .scalar_subquery()
    )
    newest_batch_s = (
        select(OBSERVATION_BATCHES.c.received_s)
        .where(OBSERVATION_BATCHES.c.session_id == newest_session)
        .order_by(OBSERVATION_BATCHES.c.seq.desc())
        .limit(1)
        .correlate(DEVICES)
        .scalar_subquery()
    )
    others = (column for column in DEVICES.c if column.name != "last_seen_s")
    seen_s = func.coalesce(newest_batch_s, DEVICES.c.last_seen_s)
    return select(*others, seen_s.label("last_seen_s"))


def _device(row: RowMapping) -> StoredDevice:
    fields = dict(row)
    return StoredDevice(device_id=fields.pop("id"), **fields)
