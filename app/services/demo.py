"""Puts the simulated warehouse into an empty database, as an admin would have done by hand."""

from collections.abc import Mapping
from dataclasses import replace

from sqlalchemy import Connection

from app.core.simulate import STOREYS, Warehouse
from app.formats.floor_map import parse_floor_map
from app.services.demo_plan import floor_map, plan_png
from app.services.errors import found
from app.storage.beacons import StoredBeacon, insert_beacon
from app.storage.database import Database
from app.storage.devices import get_device, update_device
from app.storage.enrolment import Sighting, record_sighting
from app.storage.floors import PlanImage, StoredFloor, insert_floor, set_map, set_plan
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site


async def install_warehouse(database: Database, world: Warehouse, now_s: float) -> None:
    """Store site, floors with plans and maps, beacons and the radio map, in one transaction."""

    def statement(connection: Connection) -> None:
        insert_site(connection, StoredSite(world.site.site_id, "Warehouse A", now_s))
        _insert_floors(connection, world)
        _insert_beacons(connection, world)
        if world.site.radio_map is not None:
            origin = RadioMapOrigin("Simulated survey", now_s, {"simulated_seed": world.seed})
            save_radio_map(
                connection, world.site.site_id, world.site.radio_map, origin, activate=True
            )

    await database.write(statement)


async def enrol_people(
    database: Database, site_id: str, person_by_device: Mapping[str, str], now_s: float
) -> None:
    """Say who carries which phone, so that maps and lists show people from the start."""

    def statement(connection: Connection) -> None:
        for device_id, person in person_by_device.items():
            seen = Sighting(device_id, site_id, "android", "Simulated", now_s)
            record_sighting(connection, seen)
            enrolled = found(get_device(connection, device_id), "device", device_id)
            update_device(connection, replace(enrolled, person=person))

    await database.write(statement)


def _insert_floors(connection: Connection, world: Warehouse) -> None:
    for floor, storey in zip(world.site.floors, STOREYS, strict=True):
        stored = StoredFloor(
            floor_id=floor.floor_id,
            site_id=world.site.site_id,
            name=floor.name,
            ordinal=floor.ordinal,
            width_m=floor.width_m,
            height_m=floor.height_m,
            building=floor.building,
            x0_m=floor.x0_m,
            y0_m=floor.y0_m,
        )
        insert_floor(connection, stored)
        set_plan(connection, floor.floor_id, PlanImage("image/png", plan_png(storey)))
        document = floor_map(storey)
        set_map(connection, floor.floor_id, document, parse_floor_map(document).raster())


def _insert_beacons(connection: Connection, world: Warehouse) -> None:
    for anchor in world.site.anchors:
        beacon = StoredBeacon(
            beacon_id=anchor.anchor_id,
            site_id=world.site.site_id,
            kind="ble",
            keys=anchor.keys,
            floor_id=anchor.floor_id,
            name=anchor.anchor_id.replace("beacon-", "Beacon "),
            x_m=anchor.x_m,
            y_m=anchor.y_m,
            z_m=anchor.z_m,
            ref_level_dbm=anchor.ref_level_dbm,
            ref_distance_m=anchor.ref_distance_m,
            path_loss_exponent=anchor.path_loss_exponent,
            shadowing_db=anchor.shadowing_db,
        )
        insert_beacon(connection, beacon)
