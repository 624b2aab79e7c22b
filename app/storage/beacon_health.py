"""When beacons were last heard and what they told of themselves: a table beside the registry.

It is written far more often than a beacon is edited, so it has no part in a beacon's row version.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache

from sqlalchemy import Connection, Executable, and_, case, func, or_, select

from app.storage.tables import BEACON_HEALTH, BEACONS
from app.storage.upsert import insert_into


@dataclass(frozen=True, slots=True)
class BeaconHealth:
    """What traffic says of one beacon.

    Attributes
    ----------
    last_heard_s
        Event time of the newest reading.
    told_s
        Event time of the newest telemetry; None: it never told any.
    battery_percent, battery_v, temperature_degc
        The newest of each that it told.
    """

    beacon_id: str
    last_heard_s: float
    told_s: float | None = None
    battery_percent: float | None = None
    battery_v: float | None = None
    temperature_degc: float | None = None


def note_health(connection: Connection, heard: Sequence[BeaconHealth]) -> None:
    """Store what is newer than what is stored; beacons that are gone are passed over."""
    ids = [health.beacon_id for health in heard]
    known = set(connection.execute(select(BEACONS.c.id).where(BEACONS.c.id.in_(ids))).scalars())
    rows = [asdict(health) for health in heard if health.beacon_id in known]
    if rows:
        connection.execute(_noting(connection.dialect.name), rows)


def health_of(connection: Connection, beacon_ids: Sequence[str]) -> dict[str, BeaconHealth]:
    """Return what is known of these beacons, by id; those never heard are not in it."""
    query = select(BEACON_HEALTH).where(BEACON_HEALTH.c.beacon_id.in_(beacon_ids))
    rows = [BeaconHealth(**row) for row in connection.execute(query).mappings()]
    return {health.beacon_id: health for health in rows}


def health_of_site(connection: Connection, site_id: str) -> dict[str, BeaconHealth]:
    """Return what is known of all beacons of a site, by id."""
    query = (
        select(BEACON_HEALTH)
        .join(BEACONS, BEACONS.c.id == BEACON_HEALTH.c.beacon_id)
        .where(BEACONS.c.site_id == site_id)
    )
    rows = [BeaconHealth(**row) for row in connection.execute(query).mappings()]
    return {health.beacon_id: health for health in rows}


@cache
def _noting(dialect: str) -> Executable:
    insert = insert_into(dialect, BEACON_HEALTH)
    stored, fresh = BEACON_HEALTH.c, insert.excluded
    heard = case(
        (fresh.last_heard_s > stored.last_heard_s, fresh.last_heard_s), else_=stored.last_heard_s
    )
    is_newer = and_(
        fresh.told_s.is_not(None), or_(stored.told_s.is_(None), fresh.told_s >= stored.told_s)
    )
    told = {
        name: case(
            (is_newer, func.coalesce(fresh[name], stored[name])),
            else_=func.coalesce(stored[name], fresh[name]),
        )
        for name in ("told_s", "battery_percent", "battery_v", "temperature_degc")
    }
    return insert.on_conflict_do_update(
        index_elements=[stored.beacon_id], set_={"last_heard_s": heard, **told}
    )
