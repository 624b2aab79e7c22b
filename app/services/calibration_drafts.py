"""Calibrations from the draft to the registry: made, applied in one transaction, or discarded."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any
from uuid import uuid4

from sqlalchemy import Connection

from app.core.radio.beacon_places import BeaconPlacesParams
from app.formats.floor_map import parse_floor_map
from app.services.beacon_calibration import calibrate_floor
from app.services.beacon_placing import PlacedBeacon, place_beacons
from app.services.calibration_sources import (
    Labelled,
    Names,
    names_of_strangers,
    registered_names,
)
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.planning_queue import PlanQueue
from app.services.writing import SeenVersions, check_seen, write
from app.storage import beacons, calibrations, devices, floors, sites
from app.storage.beacons import StoredBeacon
from app.storage.calibrations import StoredCalibration
from app.storage.database import Database
from app.storage.floors import StoredFloor

LEVELS, PLACES = "levels", "places"

MAX_OFFSET_DB = 40.0
"""As far as a device's level offset may be from 0; see `app.api.devices`."""


@dataclass(frozen=True, slots=True)
class PlacesRequest:
    """Whom to place: registered beacons by id (None: those without a place), and strangers."""

    beacon_ids: tuple[str, ...] | None = None
    register_unknown: bool = False


async def draft_levels(
    database: Database, queue: PlanQueue, floor: StoredFloor, labelled: Labelled, now_s: float
) -> StoredCalibration:
    """Calibrate the beacons of a floor and store the draft.

    Raises
    ------
    AppError
        If the floor has no beacons or the levels are too few.
    """
    everyone = await database.read(lambda c: beacons.beacons_of_site(c, floor.site_id))
    anchors = await database.read(lambda c: beacons.anchors_of_site(c, floor.site_id))
    document = await database.read(lambda c: floors.get_map(c, floor.floor_id))
    walls = () if document is None else parse_floor_map(document).walls
    on_floor = [anchor for anchor in anchors if anchor.floor_id == floor.floor_id]
    if not on_floor:
        raise AppError(ErrorCode.CONFLICT, f"floor {floor.floor_id!r} has no placed beacon")
    epochs = labelled.epochs(floor.floor_id, registered_names(everyone))
    found_levels = await queue.run(lambda: calibrate_floor(epochs, on_floor, walls))
    versions = {beacon.beacon_id: beacon.row_version for beacon in everyone}
    proposed = {
        beacon.beacon_id: {**asdict(beacon.after), "row_version": versions[beacon.beacon_id]}
        for beacon in found_levels.beacons
    }
    offsets_db = {
        phone.device_id: phone.offset_db
        for phone in found_levels.phones
        if phone.device_id and len(found_levels.phones) > 1
    }
    return await _store(
        database,
        floor,
        (LEVELS, labelled.described),
        asdict(found_levels),
        (proposed, offsets_db),
        now_s,
    )


async def draft_places(
    database: Database,
    queue: PlanQueue,
    floor: StoredFloor,
    labelled: Labelled,
    asked: PlacesRequest,
    now_s: float,
) -> StoredCalibration:
    """Estimate where beacons of a floor are and store the draft.

    Raises
    ------
    AppError
        If none of those asked for was heard at a known place.
    """
    everyone = await database.read(lambda c: beacons.beacons_of_site(c, floor.site_id))
    wanted = {beacon.beacon_id: beacon for beacon in _wanted(everyone, asked)}
    known = registered_names(everyone)
    epochs = labelled.epochs(floor.floor_id, known)
    strangers = Names(lambda _: None, frozenset())
    if asked.register_unknown:
        strangers = names_of_strangers(labelled, everyone)
        epochs += labelled.epochs(floor.floor_id, strangers)
    ids = [*wanted, *sorted(strangers.keys)]
    placed = await queue.run(lambda: _heard(place_beacons(epochs, ids)))
    if not placed:
        detail = "no beacon without a place was heard at a known place of this floor"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    z_m = BeaconPlacesParams().height_m
    proposed = {
        beacon.beacon_id: {
            **_columns(beacon, floor.floor_id, z_m),
            **_identity(wanted.get(beacon.beacon_id), strangers.keys.get(beacon.beacon_id, ())),
        }
        for beacon in placed
        if beacon.model is not None
    }
    report = {"beacons": [asdict(beacon) for beacon in placed]}
    return await _store(
        database, floor, (PLACES, labelled.described), report, (proposed, {}), now_s
    )


async def apply_calibration(
    database: Database, calibration_id: str, seen: SeenVersions, now_s: float
) -> StoredCalibration:
    """Put a draft's values into the registry, all or none.

    Raises
    ------
    AppError
        `CONFLICT` if it is applied already, `ETAG_MISMATCH` if one of its beacons was changed since
        it was drafted.
    """

    def statement(connection: Connection) -> StoredCalibration:
        draft = _seen(connection, calibration_id, seen)
        if draft.applied_s is not None:
            raise AppError(ErrorCode.CONFLICT, f"calibration {calibration_id!r} is applied already")
        for beacon_id, columns in draft.proposed.items():
            _apply_beacon(connection, draft.site_id, beacon_id, columns)
        for device_id, offset_db in draft.offsets_db.items():
            _apply_offset(connection, device_id, offset_db)
        sites.touch_model(connection, draft.site_id)
        version = calibrations.mark_applied(connection, draft, now_s)
        return replace(draft, applied_s=now_s, row_version=version)

    return await write(database, statement)


async def discard_calibration(database: Database, calibration_id: str, seen: SeenVersions) -> None:
    """Remove a draft, or the record of one that was applied; the registry stays as it is."""

    def statement(connection: Connection) -> None:
        _seen(connection, calibration_id, seen)
        calibrations.delete_calibration(connection, calibration_id)

    await write(database, statement)


async def _store(
    database: Database,
    floor: StoredFloor,
    what: tuple[str, Mapping[str, Any]],
    report: Mapping[str, Any],
    changes: tuple[Mapping[str, Mapping[str, Any]], Mapping[str, float]],
    now_s: float,
) -> StoredCalibration:
    kind, source = what
    proposed, offsets_db = changes
    draft = StoredCalibration(
        calibration_id=f"{floor.floor_id[:40]}-cal-{uuid4().hex[:12]}",
        site_id=floor.site_id,
        floor_id=floor.floor_id,
        kind=kind,
        source=source,
        report=report,
        proposed=proposed,
        offsets_db=offsets_db,
        created_s=now_s,
    )
    await write(database, lambda c: calibrations.insert_calibration(c, draft))
    return draft


def _wanted(everyone: Sequence[StoredBeacon], asked: PlacesRequest) -> list[StoredBeacon]:
    if asked.beacon_ids is None:
        return [beacon for beacon in everyone if beacon.floor_id is None]
    missing = set(asked.beacon_ids) - {beacon.beacon_id for beacon in everyone}
    if missing:
        detail = f"the site has no beacon {min(missing)!r}"
        raise invalid_field(pointer="#/beacon_ids", detail=detail)
    return [beacon for beacon in everyone if beacon.beacon_id in asked.beacon_ids]


def _heard(placed: Sequence[PlacedBeacon]) -> list[PlacedBeacon]:
    return [beacon for beacon in placed if beacon.levels]


def _columns(beacon: PlacedBeacon, floor_id: str, z_m: float) -> dict[str, Any]:
    model = {} if beacon.model is None else asdict(beacon.model)
    place = {"floor_id": floor_id, "x_m": beacon.x_m, "y_m": beacon.y_m, "z_m": z_m}
    return {**place, "ref_distance_m": 1.0, **model}


def _identity(known: StoredBeacon | None, keys: tuple[str, ...]) -> dict[str, Any]:
    """Return the version of a registered beacon, or what a new one is registered as."""
    if known is not None:
        return {"row_version": known.row_version}
    return {"row_version": 0, "kind": "ble", "keys": list(keys)}


def _apply_beacon(
    connection: Connection, site_id: str, beacon_id: str, columns: Mapping[str, Any]
) -> None:
    values = {name: value for name, value in columns.items() if name != "row_version"}
    if columns["row_version"] == 0:
        keys = tuple(values.pop("keys"))
        beacons.insert_beacon(
            connection, StoredBeacon(beacon_id=beacon_id, site_id=site_id, keys=keys, **values)
        )
        return
    stored = beacons.get_beacon(connection, beacon_id)
    if stored is None or stored.row_version != columns["row_version"]:
        detail = f"beacon {beacon_id!r} was changed since the draft was made; make a new one"
        raise AppError(ErrorCode.ETAG_MISMATCH, detail)
    beacons.update_beacon(connection, replace(stored, **values))


def _apply_offset(connection: Connection, device_id: str, offset_db: float) -> None:
    device = devices.get_device(connection, device_id)
    if device is None:
        return
    whole_db = device.level_offset_db + offset_db
    bounded_db = min(max(whole_db, -MAX_OFFSET_DB), MAX_OFFSET_DB)
    devices.update_device(connection, replace(device, level_offset_db=bounded_db))


def _seen(connection: Connection, calibration_id: str, seen: SeenVersions) -> StoredCalibration:
    stored = found(
        calibrations.get_calibration(connection, calibration_id), "calibration", calibration_id
    )
    check_seen(seen, stored.row_version)
    return stored
