"""Enrolment: a phone that may post becomes a device, and is kept in mind as last seen."""

from dataclasses import dataclass

from sqlalchemy import Connection

from app.storage.tables import DEVICES
from app.storage.upsert import insert_new


@dataclass(frozen=True, slots=True)
class Sighting:
    """A phone that has just posted."""

    device_id: str
    site_id: str
    platform: str
    model: str
    seen_s: float


def record_sighting(connection: Connection, sighting: Sighting) -> None:
    """Make a device of a phone not seen before; note where and when it was seen, and what it is."""
    row = {
        "id": sighting.device_id,
        "site_id": sighting.site_id,
        "platform": sighting.platform,
        "model": sighting.model,
        "last_seen_s": sighting.seen_s,
    }
    if not insert_new(connection, DEVICES, {**row, "first_seen_s": sighting.seen_s}, DEVICES.c.id):
        connection.execute(DEVICES.update().where(DEVICES.c.id == sighting.device_id).values(row))
