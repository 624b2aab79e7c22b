"""Devices as stored: the phones that have posted something, and who carries them."""

from dataclasses import dataclass

from sqlalchemy import Connection, RowMapping, delete, select

from app.storage.rows import update_row
from app.storage.tables import DEVICES
from app.storage.tokens import delete_tokens_of_device


@dataclass(frozen=True, slots=True)
class StoredDevice:
    """One phone.

    Attributes
    ----------
    site_id
        Where it was last, None if the site is gone.
    level_offset_db
        Added to every level it reports.
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
    query = select(DEVICES).order_by(DEVICES.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(DEVICES.c.site_id == site_id)
    if after is not None:
        query = query.where(DEVICES.c.id > after)
    return [_device(row) for row in connection.execute(query).mappings()]


def get_device(connection: Connection, device_id: str) -> StoredDevice | None:
    """Return a device, None if there is none of this id."""
    query = select(DEVICES).where(DEVICES.c.id == device_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _device(row)


def update_device(connection: Connection, device: StoredDevice) -> int:
    """Store what an admin may edit of a device read as ``row_version``; return the new version."""
    return update_row(
        connection,
        DEVICES,
        device.device_id,
        device.row_version,
        {"name": device.name, "person": device.person, "level_offset_db": device.level_offset_db},
    )


def erase_device(connection: Connection, device_id: str) -> None:
    """Remove a device with everything it posted, its tracks and its own tokens."""
    delete_tokens_of_device(connection, device_id)
    connection.execute(delete(DEVICES).where(DEVICES.c.id == device_id))


def _device(row: RowMapping) -> StoredDevice:
    fields = dict(row)
    return StoredDevice(device_id=fields.pop("id"), **fields)
