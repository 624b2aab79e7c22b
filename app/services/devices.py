"""The phones: edits, erasure, and whether one can be relied on now."""

from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum

from sqlalchemy import Connection

from app.services.errors import found
from app.services.writing import SeenVersions, check_seen, write
from app.sessions.registry import SessionRegistry
from app.storage import devices
from app.storage.database import Database
from app.storage.devices import StoredDevice

LIVE_S = 15.0
"""A phone posts every second; Android's scan throttling and a lift ride make gaps of ten."""

STALE_S = 300.0
"""After five minutes of silence a position says little: the phone is off, or has left."""


class DeviceStatus(StrEnum):
    """How recently a device was heard of."""

    LIVE = "live"
    STALE = "stale"
    OFFLINE = "offline"


def status_of(last_seen_s: float | None, now_s: float) -> DeviceStatus:
    """Return the status of a device last heard of at ``last_seen_s``."""
    if last_seen_s is None or now_s - last_seen_s > STALE_S:
        return DeviceStatus.OFFLINE
    return DeviceStatus.LIVE if now_s - last_seen_s <= LIVE_S else DeviceStatus.STALE


async def edit_device(
    database: Database,
    device_id: str,
    seen: SeenVersions,
    edit: Callable[[StoredDevice], StoredDevice],
) -> StoredDevice:
    """Change what an admin may say of a device; ``edit`` gets it as stored."""

    def statement(connection: Connection) -> StoredDevice:
        edited = edit(_seen_device(connection, device_id, seen))
        return replace(edited, row_version=devices.update_device(connection, edited))

    return await write(database, statement)


async def erase_device(
    database: Database, registry: SessionRegistry, device_id: str, seen: SeenVersions
) -> None:
    """Remove a device and all that is known of it, live and stored."""

    def statement(connection: Connection) -> None:
        _seen_device(connection, device_id, seen)
        devices.erase_device(connection, device_id)

    await registry.erase(device_id, lambda: write(database, statement))


def _seen_device(connection: Connection, device_id: str, seen: SeenVersions) -> StoredDevice:
    device = found(devices.get_device(connection, device_id), "device", device_id)
    check_seen(seen, device.row_version)
    return device
