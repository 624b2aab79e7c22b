"""What a site is matched with stays the same object until it is something else."""

from dataclasses import replace

import pytest
from sqlalchemy import Connection

from app.core.engine.standing import ground_of
from app.core.fingerprint.ageing import Change, Suspect
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.site import SiteModel
from app.services.site import SiteDirectory
from app.storage import ageing
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site, touch_model

KEYS = ("mac:020000000001", "mac:020000000002")


def _map() -> RadioMap:
    walked = [
        Fingerprint(0, 2.0 * i, 5.0, dict.fromkeys(KEYS, -50.0 - i), {}, "w", float(i))
        for i in range(4)
    ]
    return build_radio_map(("hall-0",), walked)


def _save(connection: Connection) -> str:
    origin = RadioMapOrigin("m", 0.0)
    return save_radio_map(connection, "hall", _map(), origin, activate=True).radio_map_id


def _fill(connection: Connection) -> str:
    insert_site(connection, StoredSite("hall", "Hall", 0.0))
    insert_floor(connection, StoredFloor("hall-0", "hall", "Ground", 0, 20.0, 10.0))
    return _save(connection)


def _quarantine(connection: Connection, radio_map_id: str) -> None:
    suspect = Suspect(KEYS[0], Change.MOVED, 1.5, 9, 3, 7.0)
    ageing.replace_suspects(connection, radio_map_id, [suspect], 1.0)
    ageing.set_quarantine(connection, radio_map_id, [KEYS[0]], quarantined=True)


@pytest.mark.anyio
async def test_an_edit_of_the_site_keeps_its_radio_map_and_another_map_replaces_it(
    database_url: str,
) -> None:
    database = Database(database_url)
    directory = SiteDirectory(database)

    async def model() -> SiteModel:
        await directory.refresh()
        current = directory.current("hall")
        assert current is not None
        return current

    radio_map_id = await database.write(_fill)
    first = await model()
    await database.write(lambda c: touch_model(c, "hall"))
    edited = await model()
    assert edited.version > first.version
    assert edited.radio_map is first.radio_map
    assert ground_of(None, edited).ways is ground_of(None, first).ways
    await database.write(lambda c: _quarantine(c, radio_map_id))
    quarantined = (await model()).radio_map
    assert quarantined is not None
    assert quarantined.transmitters == KEYS[1:]
    await database.write(_save)
    newest = (await model()).radio_map
    assert newest is not None
    assert newest is not first.radio_map
    assert newest.transmitters == KEYS
    turned = replace(edited, x_axis_from_east_rad=0.5)
    assert ground_of(None, turned).ways is not ground_of(None, first).ways
    await database.close()
