"""Radio maps as versions: one active, taken back in the order in which they were made so."""

from collections.abc import Iterator

import numpy as np
import pytest

from app.core.fingerprint.cleaning import LevelStatistics
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.storage.database import Database
from app.storage.radio_maps import (
    RadioMapOrigin,
    StoredRadioMap,
    activate_radio_map,
    delete_radio_map,
    get_radio_map,
    list_radio_maps,
    load_active,
    load_statistics,
    roll_back,
    save_radio_map,
)
from app.storage.sites import StoredSite, get_site, insert_site

MAP = build_radio_map(("f",), [Fingerprint(0, 1.0, 2.0, {"mac:000000000001": -60.0}, {}, "w")])


@pytest.fixture
def database(storage_url: str) -> Iterator[Database]:
    opened = Database(storage_url)
    for site_id in ("hall", "other"):
        opened.write_now(lambda c, s=site_id: insert_site(c, StoredSite(s, s, 0.0)))
    yield opened
    opened.close_now()


def saved(database: Database, name: str, site_id: str = "hall", **fields: object) -> StoredRadioMap:
    origin = RadioMapOrigin(name, 0.0, None, **fields)
    return database.write_now(lambda c: save_radio_map(c, site_id, MAP, origin, activate=False))


def activate(database: Database, stored: StoredRadioMap) -> None:
    database.write_now(lambda c: activate_radio_map(c, stored))


def active_name(database: Database, site_id: str = "hall") -> str | None:
    rows = database.read_now(lambda c: list_radio_maps(c, site_id=site_id, active=True, limit=9))
    assert len(rows) <= 1
    return rows[0].name if rows else None


def back(database: Database) -> str | None:
    stored = database.write_now(lambda c: roll_back(c, "hall"))
    return None if stored is None else stored.name


def test_rolling_back_goes_through_what_was_active_and_no_further(database: Database) -> None:
    a, b, c = (saved(database, name) for name in "abc")
    for stored in (b, a, c):
        activate(database, stored)
    assert (active_name(database), back(database)) == ("c", "a")
    assert (active_name(database), back(database)) == ("a", "b")
    assert (active_name(database), back(database)) == ("b", None)
    assert active_name(database) == "b"


def test_a_map_taken_back_can_be_activated_again(database: Database) -> None:
    a, b = saved(database, "a"), saved(database, "b")
    activate(database, a)
    activate(database, b)
    back(database)
    activate(database, b)
    assert (active_name(database), back(database)) == ("b", "a")


def test_other_sites_keep_their_map(database: Database) -> None:
    activate(database, saved(database, "theirs", "other"))
    a, b = saved(database, "a"), saved(database, "b")
    activate(database, a)
    activate(database, b)
    assert back(database) == "a"
    assert active_name(database, "other") == "theirs"


def test_every_switch_is_one_that_live_sessions_see(database: Database) -> None:
    def version() -> int:
        site = database.read_now(lambda c: get_site(c, "hall"))
        assert site is not None
        return site.model_version

    a, b = saved(database, "a"), saved(database, "b")
    seen = [version()]
    for switch in (lambda: activate(database, a), lambda: activate(database, b)):
        switch()
        seen.append(version())
    back(database)
    seen.append(version())
    assert seen == sorted(set(seen))


def test_the_active_map_is_never_removed(database: Database) -> None:
    a, b = saved(database, "a"), saved(database, "b")
    activate(database, a)
    for stored in (a, b):
        database.write_now(lambda c, s=stored: delete_radio_map(c, s.radio_map_id))
    assert database.read_now(lambda c: load_active(c, "hall")) is not None
    assert database.read_now(lambda c: get_radio_map(c, b.radio_map_id)) is None


def test_the_scatter_of_levels_is_stored_beside_the_map(database: Database) -> None:
    statistics = LevelStatistics(np.array([0.5]), np.array([5]), np.array([0.75]))
    with_it, without = saved(database, "a", statistics=statistics), saved(database, "b")
    loaded = database.read_now(lambda c: load_statistics(c, with_it.radio_map_id))
    assert loaded is not None
    assert (loaded.deviation_db[0], loaded.count[0], loaded.heard_share[0]) == (0.5, 5, 0.75)
    assert database.read_now(lambda c: load_statistics(c, without.radio_map_id)) is None
