"""Beacons and access points as stored: place, calibration, and the keys they go by."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, Select, delete, insert, select

from app.core.types import Anchor
from app.storage.rows import unique, update_row
from app.storage.tables import BEACON_HEALTH, BEACON_KEYS, BEACONS


@dataclass(frozen=True, slots=True)
class StoredBeacon:
    """One transmitter of the registry; without a floor it is registered but not placed yet."""

    beacon_id: str
    site_id: str
    kind: str
    keys: tuple[str, ...]
    floor_id: str | None = None
    name: str = ""
    x_m: float | None = None
    y_m: float | None = None
    z_m: float = 0.0
    ref_level_dbm: float = -59.0
    ref_distance_m: float = 1.0
    path_loss_exponent: float = 2.0
    shadowing_db: float = 5.0
    row_version: int = 1


@dataclass(frozen=True, slots=True)
class BeaconFilter:
    """Which beacons to list; None does not limit.

    ``not_heard_since_s``: those never heard, or last before it.
    """

    site_id: str | None = None
    floor_id: str | None = None
    kind: str | None = None
    not_heard_since_s: float | None = None


def list_beacons(
    connection: Connection, which: BeaconFilter, *, after: str | None = None, limit: int
) -> list[StoredBeacon]:
    """Return up to ``limit + 1`` beacons by id."""
    query = select(BEACONS).order_by(BEACONS.c.id).limit(limit + 1)
    wanted = {"site_id": which.site_id, "floor_id": which.floor_id, "kind": which.kind}
    for name, value in wanted.items():
        if value is not None:
            query = query.where(BEACONS.c[name] == value)
    if which.not_heard_since_s is not None:
        heard = select(BEACON_HEALTH.c.beacon_id).where(
            BEACON_HEALTH.c.last_heard_s >= which.not_heard_since_s
        )
        query = query.where(BEACONS.c.id.not_in(heard))
    if after is not None:
        query = query.where(BEACONS.c.id > after)
    return _beacons(connection, query)


def beacons_of_site(connection: Connection, site_id: str) -> list[StoredBeacon]:
    """Return all beacons of a site by id."""
    query = select(BEACONS).where(BEACONS.c.site_id == site_id).order_by(BEACONS.c.id)
    return _beacons(connection, query)


def beacon_ids_by_key(
    connection: Connection, site_id: str, keys: Sequence[str] | None = None
) -> dict[str, str]:
    """Return, by key, the ids of beacons of a site, those without a place too; None: of all."""
    query = select(BEACON_KEYS.c.key, BEACON_KEYS.c.beacon_id)
    query = query.where(BEACON_KEYS.c.site_id == site_id)
    if keys is not None:
        query = query.where(BEACON_KEYS.c.key.in_(keys))
    return {row.key: row.beacon_id for row in connection.execute(query)}


def anchors_of_site(connection: Connection, site_id: str) -> tuple[Anchor, ...]:
    """Return the beacons of a site that have a place, as the estimators see them."""
    return tuple(
        Anchor(
            anchor_id=beacon.beacon_id,
            keys=beacon.keys,
            floor_id=beacon.floor_id,
            x_m=beacon.x_m,
            y_m=beacon.y_m,
            z_m=beacon.z_m,
            ref_level_dbm=beacon.ref_level_dbm,
            ref_distance_m=beacon.ref_distance_m,
            path_loss_exponent=beacon.path_loss_exponent,
            shadowing_db=beacon.shadowing_db,
        )
        for beacon in beacons_of_site(connection, site_id)
        if beacon.floor_id is not None and beacon.x_m is not None and beacon.y_m is not None
    )


def get_beacon(connection: Connection, beacon_id: str) -> StoredBeacon | None:
    """Return a beacon, None if there is none of this id."""
    found = _beacons(connection, select(BEACONS).where(BEACONS.c.id == beacon_id))
    return found[0] if found else None


def insert_beacon(connection: Connection, beacon: StoredBeacon) -> StoredBeacon:
    """Store a new beacon with its keys."""
    with unique(f"beacon {beacon.beacon_id!r}"):
        connection.execute(
            insert(BEACONS).values(id=beacon.beacon_id, site_id=beacon.site_id, **_editable(beacon))
        )
    _insert_keys(connection, beacon)
    return beacon


def update_beacon(connection: Connection, beacon: StoredBeacon) -> int:
    """Store the edited fields and keys of a beacon read as ``row_version``; return the new one."""
    version = update_row(
        connection, BEACONS, beacon.beacon_id, beacon.row_version, _editable(beacon)
    )
    drop_keys(connection, beacon.beacon_id)
    _insert_keys(connection, beacon)
    return version


def delete_beacon(connection: Connection, beacon_id: str) -> None:
    """Remove a beacon with its keys."""
    connection.execute(delete(BEACONS).where(BEACONS.c.id == beacon_id))


def drop_keys(connection: Connection, beacon_id: str) -> None:
    """Remove the keys of a beacon, for edits that hand keys from one beacon to another."""
    connection.execute(delete(BEACON_KEYS).where(BEACON_KEYS.c.beacon_id == beacon_id))


def beacon_ids_elsewhere(connection: Connection, site_id: str) -> set[str]:
    """Return the ids of all beacons of other sites."""
    return set(
        connection.execute(select(BEACONS.c.id).where(BEACONS.c.site_id != site_id)).scalars()
    )


def _insert_keys(connection: Connection, beacon: StoredBeacon) -> None:
    rows = [
        {"site_id": beacon.site_id, "key": key, "beacon_id": beacon.beacon_id, "rank": rank}
        for rank, key in enumerate(beacon.keys)
    ]
    with unique(f"another beacon of the site with a key of {beacon.beacon_id!r}"):
        connection.execute(insert(BEACON_KEYS), rows)


def _beacons(connection: Connection, query: Select[Any]) -> list[StoredBeacon]:
    rows = connection.execute(query).mappings().all()
    ids = query.with_only_columns(BEACONS.c.id).subquery()
    keys: dict[str, list[str]] = {}
    of_rows = (
        select(BEACON_KEYS.c.beacon_id, BEACON_KEYS.c.key)
        .join(ids, ids.c.id == BEACON_KEYS.c.beacon_id)
        .order_by(BEACON_KEYS.c.beacon_id, BEACON_KEYS.c.rank)
    )
    for beacon_id, key in connection.execute(of_rows):
        keys.setdefault(beacon_id, []).append(key)
    return [_beacon(row, keys.get(row["id"], [])) for row in rows]


def _beacon(row: RowMapping, keys: Sequence[str]) -> StoredBeacon:
    fields = dict(row)
    return StoredBeacon(beacon_id=fields.pop("id"), keys=tuple(keys), **fields)


def _editable(beacon: StoredBeacon) -> dict[str, Any]:
    return {
        "floor_id": beacon.floor_id,
        "kind": beacon.kind,
        "name": beacon.name,
        "x_m": beacon.x_m,
        "y_m": beacon.y_m,
        "z_m": beacon.z_m,
        "ref_level_dbm": beacon.ref_level_dbm,
        "ref_distance_m": beacon.ref_distance_m,
        "path_loss_exponent": beacon.path_loss_exponent,
        "shadowing_db": beacon.shadowing_db,
    }
