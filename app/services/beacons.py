"""Edits of the beacon registry, one by one and by the table."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from sqlalchemy import Connection

from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.writing import SeenVersions, check_seen, write
from app.storage import beacons, floors, sites
from app.storage.beacons import StoredBeacon
from app.storage.database import Database


async def create_beacon(database: Database, beacon: StoredBeacon) -> StoredBeacon:
    """Add a beacon to a site."""

    def statement(connection: Connection) -> StoredBeacon:
        found(sites.get_site(connection, beacon.site_id), "site", beacon.site_id)
        _check_floor(connection, beacon)
        _check_keys(connection, beacon)
        beacons.insert_beacon(connection, beacon)
        sites.touch_model(connection, beacon.site_id)
        return beacon

    return await write(database, statement)


async def edit_beacon(
    database: Database,
    beacon_id: str,
    seen: SeenVersions,
    edit: Callable[[StoredBeacon], StoredBeacon],
) -> StoredBeacon:
    """Change a beacon; ``edit`` gets it as stored."""

    def statement(connection: Connection) -> StoredBeacon:
        edited = edit(_seen_beacon(connection, beacon_id, seen))
        _check_floor(connection, edited)
        _check_keys(connection, edited)
        version = beacons.update_beacon(connection, edited)
        sites.touch_model(connection, edited.site_id)
        return replace(edited, row_version=version)

    return await write(database, statement)


async def edit_beacons(
    database: Database,
    edits: Mapping[str, tuple[SeenVersions, Callable[[StoredBeacon], StoredBeacon]]],
) -> list[StoredBeacon]:
    """Change several beacons, all or none; keys may go from one of them to another."""

    def statement(connection: Connection) -> list[StoredBeacon]:
        edited = [
            edit(_seen_beacon(connection, beacon_id, seen))
            for beacon_id, (seen, edit) in edits.items()
        ]
        for beacon in edited:
            _check_floor(connection, beacon)
            beacons.drop_keys(connection, beacon.beacon_id)
        stored = [_updated(connection, beacon) for beacon in edited]
        for site_id in {beacon.site_id for beacon in stored}:
            sites.touch_model(connection, site_id)
        return stored

    return await write(database, statement)


async def delete_beacon(database: Database, beacon_id: str, seen: SeenVersions) -> None:
    """Remove a beacon."""

    def statement(connection: Connection) -> None:
        beacon = _seen_beacon(connection, beacon_id, seen)
        beacons.delete_beacon(connection, beacon_id)
        sites.touch_model(connection, beacon.site_id)

    await write(database, statement)


@dataclass(frozen=True, slots=True)
class TableRow:
    """A beacon of a table, whole if it is new; ``unsaid`` stays as it is stored if it is not."""

    beacon: StoredBeacon
    unsaid: frozenset[str] = frozenset()

    def over(self, stored: StoredBeacon | None) -> StoredBeacon:
        """Return the beacon as it is after the table."""
        if stored is None:
            return self.beacon
        return replace(self.beacon, **{name: getattr(stored, name) for name in self.unsaid})


@dataclass(frozen=True, slots=True)
class Refused:
    """A beacon of a table that cannot be taken: its place in the table, and why."""

    index: int
    detail: str


@dataclass(frozen=True, slots=True)
class ImportPlan:
    """What an import does, or would do; ``before`` are those to be changed as they are stored."""

    created: tuple[StoredBeacon, ...] = ()
    updated: tuple[StoredBeacon, ...] = ()
    unchanged: int = 0
    refused: tuple[Refused, ...] = ()
    before: dict[str, StoredBeacon] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What a table of beacons meets at its site."""

    stored: dict[str, StoredBeacon]
    floor_ids: frozenset[str]
    ids_elsewhere: frozenset[str] = field(default_factory=frozenset)


def plan_import(table: Sequence[TableRow], around: Surroundings) -> ImportPlan:
    """Sort the rows of a table into new, changed, equal and impossible ones; ids decide."""
    rows = [row.over(around.stored.get(row.beacon.beacon_id)) for row in table]
    refused: list[Refused] = []
    taken: dict[str, StoredBeacon] = {}
    named = {row.beacon_id for row in rows}
    owners = {
        key: beacon.beacon_id
        for beacon in around.stored.values()
        if beacon.beacon_id not in named
        for key in beacon.keys
    }
    for index, row in enumerate(rows):
        reason = _refusal(row, taken, owners, around)
        if reason:
            refused.append(Refused(index, reason))
            continue
        taken[row.beacon_id] = row
        owners.update(dict.fromkeys(row.keys, row.beacon_id))
    changed = _changed(taken.values(), around.stored)
    created = tuple(row for row in taken.values() if row.beacon_id not in around.stored)
    unchanged = len(taken) - len(created) - len(changed)
    before = {row.beacon_id: around.stored[row.beacon_id] for row in changed}
    return ImportPlan(created, changed, unchanged, tuple(refused), before)


async def import_beacons(
    database: Database, site_id: str, table: Sequence[TableRow], *, dry_run: bool
) -> ImportPlan:
    """Add and change the beacons of a table in one transaction; ``dry_run`` only tells."""

    def plan(connection: Connection) -> ImportPlan:
        found(sites.get_site(connection, site_id), "site", site_id)
        return plan_import(table, _surroundings(connection, site_id))

    def statement(connection: Connection) -> ImportPlan:
        planned = plan(connection)
        for beacon in planned.updated:
            beacons.drop_keys(connection, beacon.beacon_id)
        for beacon in planned.updated:
            beacons.update_beacon(connection, beacon)
        for beacon in planned.created:
            beacons.insert_beacon(connection, beacon)
        if planned.created or planned.updated:
            sites.touch_model(connection, site_id)
        return planned

    return await (database.read(plan) if dry_run else write(database, statement))


def _surroundings(connection: Connection, site_id: str) -> Surroundings:
    return Surroundings(
        {b.beacon_id: b for b in beacons.beacons_of_site(connection, site_id)},
        frozenset(floor.floor_id for floor in floors.floors_of_site(connection, site_id)),
        frozenset(beacons.beacon_ids_elsewhere(connection, site_id)),
    )


def _refusal(
    row: StoredBeacon,
    taken: dict[str, StoredBeacon],
    owners: dict[str, str],
    around: Surroundings,
) -> str:
    if row.beacon_id in taken:
        return f"beacon {row.beacon_id!r} is twice in the table"
    if row.beacon_id in around.ids_elsewhere:
        return f"beacon {row.beacon_id!r} belongs to another site"
    if row.floor_id is not None and row.floor_id not in around.floor_ids:
        return f"the site has no floor {row.floor_id!r}"
    for key in row.keys:
        if key in owners:
            return f"{key} is already a key of beacon {owners[key]!r}"
    return ""


def _changed(
    rows: Iterable[StoredBeacon], stored: dict[str, StoredBeacon]
) -> tuple[StoredBeacon, ...]:
    versioned = (
        replace(row, row_version=stored[row.beacon_id].row_version)
        for row in rows
        if row.beacon_id in stored
    )
    return tuple(row for row in versioned if row != stored[row.beacon_id])


def _check_floor(connection: Connection, beacon: StoredBeacon) -> None:
    if beacon.floor_id is None:
        return
    floor = floors.get_floor(connection, beacon.floor_id)
    if floor is None or floor.site_id != beacon.site_id:
        raise invalid_field(
            pointer="#/floor_id",
            detail=f"site {beacon.site_id!r} has no floor {beacon.floor_id!r}",
        )


def _check_keys(connection: Connection, beacon: StoredBeacon) -> None:
    owners = beacons.beacon_ids_by_key(connection, beacon.site_id, beacon.keys)
    for key in beacon.keys:
        if owners.get(key, beacon.beacon_id) != beacon.beacon_id:
            detail = f"{key} is already a key of beacon {owners[key]!r}"
            raise AppError(ErrorCode.CONFLICT, detail)


def _updated(connection: Connection, beacon: StoredBeacon) -> StoredBeacon:
    _check_keys(connection, beacon)
    return replace(beacon, row_version=beacons.update_beacon(connection, beacon))


def _seen_beacon(connection: Connection, beacon_id: str, seen: SeenVersions) -> StoredBeacon:
    beacon = found(beacons.get_beacon(connection, beacon_id), "beacon", beacon_id)
    check_seen(seen, beacon.row_version, f"beacon {beacon_id!r}")
    return beacon
