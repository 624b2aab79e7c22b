"""What traffic says of beacons, on both databases: only what is newer counts, field by field."""

import pytest

from app.storage import beacons
from app.storage.beacon_health import BeaconHealth, health_of, health_of_site, note_health
from app.storage.beacons import BeaconFilter, StoredBeacon
from app.storage.database import Database

pytestmark = pytest.mark.anyio


async def stored(database: Database, *heard: BeaconHealth) -> BeaconHealth:
    for health in heard:
        await database.write(lambda c, h=health: note_health(c, [h]))
    return (await database.read(lambda c: health_of(c, ["b1"])))["b1"]


@pytest.fixture
async def beacon(database: Database, site: str) -> StoredBeacon:
    new = StoredBeacon("b1", site, "ble", ("mac:a4c138000001",))
    await database.write(lambda c: beacons.insert_beacon(c, new))
    return new


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)])
async def test_the_newest_counts_in_whatever_order_it_is_written(
    database: Database, beacon: StoredBeacon, order: tuple[int, ...]
) -> None:
    _ = beacon
    told = [
        BeaconHealth("b1", 10.0, 10.0, 90.0, 3.1, None),
        BeaconHealth("b1", 20.0, 20.0, None, 3.0, 21.0),
        BeaconHealth("b1", 30.0, 30.0, None, 2.9, None),
        BeaconHealth("b1", 40.0),
    ]
    # What only an older report told is kept as far as no newer one has told it.
    found = await stored(database, *(told[i] for i in order))
    assert (found.last_heard_s, found.told_s, found.battery_v) == (40.0, 30.0, 2.9)
    assert (found.battery_percent, found.temperature_degc) == (90.0, 21.0)


async def test_a_beacon_that_is_gone_takes_nobody_with_it(
    database: Database, beacon: StoredBeacon, site: str
) -> None:
    heard = [BeaconHealth("gone", 10.0), BeaconHealth("b1", 10.0)]
    await database.write(lambda c: note_health(c, heard))
    assert set(await database.read(lambda c: health_of_site(c, site))) == {"b1"}
    before = await database.read(lambda c: beacons.get_beacon(c, "b1"))
    assert before == beacon
    await database.write(lambda c: beacons.delete_beacon(c, "b1"))
    assert await database.read(lambda c: health_of(c, ["b1"])) == {}


async def test_those_not_heard_since_are_listed(
    database: Database, beacon: StoredBeacon, site: str
) -> None:
    _ = beacon
    await database.write(lambda c: note_health(c, [BeaconHealth("b1", 10.0)]))
    for since_s, listed in ((10.0, []), (10.5, ["b1"])):
        which = BeaconFilter(site, not_heard_since_s=since_s)
        found = await database.read(lambda c, w=which: beacons.list_beacons(c, w, limit=9))
        assert [each.beacon_id for each in found] == listed
