"""The repositories on both databases: stored is read back, edits count, keys are unique."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.geometry import Walkable
from app.services.site import SiteDirectory
from app.storage import beacons, devices, floors, radio_maps, sites, tokens
from app.storage.beacons import BeaconFilter, StoredBeacon
from app.storage.database import Database
from app.storage.floors import PlanImage, StoredFloor
from app.storage.radio_maps import RadioMapOrigin
from app.storage.rows import DuplicateError, StaleError
from app.storage.sites import StoredSite
from app.storage.tokens import StoredToken

pytestmark = pytest.mark.anyio

WALL = {
    "type": "Feature",
    "properties": {"kind": "wall"},
    "geometry": {"type": "LineString", "coordinates": [[0, 0], [4, 0]]},
}
BEACON = StoredBeacon(
    "b1", "site-1", "ble", ("mac:a4c138000001", "mac:a4c138000002"), "F1", "", 1, 2
)


def radio_map(*floor_ids: str) -> RadioMap:
    return build_radio_map(
        floor_ids,
        [
            Fingerprint(i, float(i), 2.0, {"mac:000000000001": -60.0 - i}, {}, f"w{i}")
            for i in range(len(floor_ids))
        ],
    )


async def save(database: Database, *floor_ids: str, activate: bool) -> radio_maps.StoredRadioMap:
    origin = RadioMapOrigin("survey", 5.0, {"walks": 2})
    return await database.write(
        lambda c: radio_maps.save_radio_map(
            c, "site-1", radio_map(*floor_ids), origin, activate=activate
        )
    )


async def test_a_site_is_read_back_and_edits_count(database: Database, site: str) -> None:
    _ = site
    points = [{"x": 0.0, "y": 1.0, "lat": 2.0, "lon": 3.0}]
    new = StoredSite("s2", "Two", 7.0, 30.0, georeference=points)
    await database.write(lambda c: sites.insert_site(c, new))
    assert await database.read(lambda c: sites.get_site(c, "s2")) == new
    with pytest.raises(DuplicateError):
        await database.write(lambda c: sites.insert_site(c, new))
    edited = replace(new, name="Three", georeference=None)
    assert await database.write(lambda c: sites.update_site(c, edited)) == 2
    with pytest.raises(StaleError):
        await database.write(lambda c: sites.update_site(c, edited))
    assert await database.read(lambda c: sites.get_site(c, "s2")) == replace(edited, row_version=2)
    listed = await database.read(lambda c: sites.list_sites(c, after="s", limit=1))
    assert [s.site_id for s in listed] == ["s2", "site-1"]
    await database.write(lambda c: sites.delete_site(c, "s2"))
    assert await database.read(lambda c: sites.get_site(c, "s2")) is None


async def test_a_floor_keeps_plan_map_and_raster(database: Database, site: str) -> None:
    raster = Walkable(0.25, 0.25, 0.5, np.arange(6.0).reshape(2, 3))
    document = {"type": "FeatureCollection", "features": [WALL]}
    plan = PlanImage("image/png", b"\x89PNG")
    stored = StoredFloor("F3", site, "Attic", 3, 10.0, 20.0, "Main", -1.0, -2.0)
    await database.write(lambda c: floors.insert_floor(c, stored))
    await database.write(lambda c: floors.set_plan(c, "F3", plan))
    await database.write(lambda c: floors.set_map(c, "F3", document, raster))
    read = await database.read(lambda c: floors.get_floor(c, "F3"))
    assert read == replace(stored, plan_media_type="image/png", has_map=True, row_version=3)
    assert await database.read(lambda c: floors.get_plan(c, "F3")) == plan
    assert await database.read(lambda c: floors.get_map(c, "F3")) == document
    again = await database.read(lambda c: floors.get_walkable(c, "F3"))
    np.testing.assert_array_equal(again.distance_m, raster.distance_m)
    await database.write(lambda c: floors.set_plan(c, "F3", None))
    await database.write(lambda c: floors.set_map(c, "F3", None, None))
    assert await database.read(lambda c: floors.get_plan(c, "F3")) is None
    assert (await database.read(lambda c: floors.get_floor(c, "F3"))).has_map is False
    with pytest.raises(DuplicateError):
        await database.write(lambda c: floors.insert_floor(c, replace(stored, floor_id="F4")))


async def test_beacons_keep_their_keys_in_order(database: Database, site: str) -> None:
    _ = site
    await database.write(lambda c: beacons.insert_beacon(c, BEACON))
    other = replace(BEACON, beacon_id="b2", keys=("mac:a4c138000002",))
    with pytest.raises(DuplicateError):
        await database.write(lambda c: beacons.insert_beacon(c, other))
    unplaced = replace(other, keys=("mac:a4c138000003",), floor_id=None, x_m=None, y_m=None)
    await database.write(lambda c: beacons.insert_beacon(c, unplaced))
    anchors = await database.read(lambda c: beacons.anchors_of_site(c, "site-1"))
    assert [(a.anchor_id, a.keys) for a in anchors] == [("b1", BEACON.keys)]
    turned = replace(BEACON, keys=BEACON.keys[::-1], z_m=2.5)
    assert await database.write(lambda c: beacons.update_beacon(c, turned)) == 2
    listed = await database.read(
        lambda c: beacons.list_beacons(c, BeaconFilter(floor_id="F1"), limit=5)
    )
    assert listed == [replace(turned, row_version=2)]


async def test_a_removed_floor_leaves_its_beacons_unplaced(database: Database, site: str) -> None:
    _ = site
    await database.write(lambda c: beacons.insert_beacon(c, BEACON))
    await database.write(lambda c: floors.delete_floor(c, "F1"))
    assert (await database.read(lambda c: beacons.get_beacon(c, "b1"))).floor_id is None
    assert await database.read(lambda c: beacons.anchors_of_site(c, "site-1")) == ()


async def test_one_radio_map_of_a_site_is_active(database: Database, site: str) -> None:
    _ = site
    first = await save(database, "F1", activate=True)
    second = await save(database, "F1", "F2", activate=False)
    assert (first.version, first.active, second.version, second.active) == (1, True, 2, False)
    await database.write(lambda c: radio_maps.activate_radio_map(c, second))
    listed = await database.read(lambda c: radio_maps.list_radio_maps(c, active=True, limit=5))
    assert listed == [replace(second, active=True)]
    active = await database.read(lambda c: radio_maps.load_active(c, "site-1"))
    expected = radio_map("F1", "F2")
    assert active.floor_ids == expected.floor_ids
    assert active.transmitters == expected.transmitters
    np.testing.assert_array_equal(active.rssi_dbm, expected.rssi_dbm)
    np.testing.assert_array_equal(active.column_start, expected.column_start)


async def test_the_directory_follows_edits_made_elsewhere(database: Database, site: str) -> None:
    _ = site
    directory = SiteDirectory(database)
    assert directory.current("site-1") is None
    await directory.refresh()
    before = directory.current("site-1")
    assert [f.floor_id for f in before.floors] == ["F1", "F2"]
    assert (before.anchors, before.radio_map) == ((), None)
    await directory.refresh()
    assert directory.current("site-1") is before

    await save(database, "F2", "gone", activate=True)
    await directory.refresh()
    after = directory.current("site-1")
    assert after.version > before.version
    assert (after.radio_map.floor_ids, after.radio_map.rows) == (("F1", "F2"), 1)
    assert after.radio_map.floor_index.tolist() == [1]

    await database.write(lambda c: sites.delete_site(c, "site-1"))
    await directory.refresh()
    assert (directory.current("site-1"), directory.site_ids()) == (None, ())


async def test_a_radio_map_of_other_floors_is_none(database: Database, site: str) -> None:
    _ = site
    await save(database, "gone", activate=True)
    directory = SiteDirectory(database)
    await directory.refresh()
    assert directory.current("site-1").radio_map is None


async def test_tokens_are_found_until_they_are_revoked(database: Database, site: str) -> None:
    assert await database.read(tokens.any_token) is False
    token = StoredToken("t1", "door", b"\x01" * 32, "device", 1.0, site, "phone", None, 9.0)
    await database.write(lambda c: tokens.create_token(c, token))
    assert await database.read(tokens.any_token) is True
    assert await database.read(lambda c: tokens.find_token(c, token.token_hash)) == token
    assert await database.write(lambda c: tokens.revoke_token(c, "t1", 5.0)) is True
    assert await database.write(lambda c: tokens.revoke_token(c, "t1", 6.0)) is True
    assert await database.write(lambda c: tokens.revoke_token(c, "t2", 6.0)) is False
    assert await database.read(lambda c: tokens.find_token(c, token.token_hash)) is None
    kept = await database.read(lambda c: tokens.get_token(c, "t1"))
    assert kept == replace(token, revoked_s=5.0)


async def test_a_token_goes_with_its_site_or_device(database: Database, site: str) -> None:
    of_site = StoredToken("t1", "", b"\x01" * 32, "viewer", 1.0, site)
    of_device = StoredToken("t2", "", b"\x02" * 32, "device", 1.0, None, "phone")
    for token in (of_site, of_device):
        await database.write(lambda c, token=token: tokens.create_token(c, token))
    await database.write(lambda c: devices.erase_device(c, "phone"))
    await database.write(lambda c: sites.delete_site(c, site))
    assert await database.read(tokens.any_token) is False
