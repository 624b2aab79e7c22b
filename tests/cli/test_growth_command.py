"""``pharos growth``: sessions kept aside are looked at, accepted or discarded."""

import asyncio
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from sqlalchemy import Connection
from typer.testing import CliRunner, Result
from wifi_hall import levels_dbm, walked

from app.cli.errors import CommandError
from app.cli.main import cli
from app.core.engine.growing import FinishedSession
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.session import SessionClock, SessionRecord
from app.storage.database import Database
from app.storage.enrolment import Sighting, record_sighting
from app.storage.floors import StoredFloor, insert_floor
from app.storage.log import SqlObservationLog
from app.storage.quarantine import count_quarantined, quarantine
from app.storage.radio_maps import RadioMapOrigin, list_radio_maps, save_radio_map
from app.storage.sites import StoredSite, insert_site

CORNERS = [(2.0, 5.0), (18.0, 5.0), (18.0, 9.0), (2.0, 9.0)]
WALKS = 3

Growth = Callable[..., Result]


def fill(connection: Connection) -> None:
    insert_site(connection, StoredSite("lab", "Lab", 0.0))
    insert_floor(connection, StoredFloor("lab-0", "lab", "Ground", 0, 20.0, 10.0))
    grid = np.arange(0.0, 11.0, 2.0).tolist()
    rows = [Fingerprint(0, x, y, levels_dbm(x, y), {}, f"line-{x:g}") for x in grid for y in grid]
    radio_map = build_radio_map(("lab-0",), rows)
    origin = RadioMapOrigin("left half", 0.0)
    save_radio_map(connection, "lab", radio_map, origin, activate=True)
    record_sighting(connection, Sighting("phone-7", "lab", "other", "", 0.0))


async def keep_aside(store: Database) -> None:
    log = SqlObservationLog(store)
    for i in range(WALKS):
        name = f"walk-{i}"
        clock = SessionClock(recorded=True)
        await log.open_session(SessionRecord(name, "phone-7", name, "lab", "best", clock, 0.0))
        await log.finish_session(name)
        told = tuple(walked(CORNERS, np.random.default_rng(i), 28.0))
        session = FinishedSession(name, told)
        await store.write(partial(quarantine, site_id="lab", session=session, collected_s=0.0))


@pytest.fixture
def store(database_url: str) -> Iterator[Database]:
    opened = Database(database_url)
    opened.write_now(fill)
    yield opened
    opened.close_now()


@pytest.fixture
def growth(database_url: str) -> Growth:
    def run(*words: str) -> Result:
        return CliRunner().invoke(
            cli, ["growth", *words, "--database", database_url], env={"COLUMNS": "200"}
        )

    return run


def waiting(store: Database) -> int:
    return store.read_now(lambda c: count_quarantined(c, "lab"))


def test_a_look_changes_nothing_and_what_is_accepted_is_a_version(
    growth: Growth, store: Database
) -> None:
    asyncio.run(keep_aside(store))
    seen = growth("look", "lab")
    assert seen.exit_code == 0, seen.output
    assert f"{WALKS} sessions kept aside" in seen.stderr
    assert "before" in seen.stderr
    assert waiting(store) == WALKS
    accepted = growth("accept", "lab", "--no-activate")
    assert accepted.exit_code == 0, accepted.output
    maps = {
        each.radio_map_id: each
        for each in store.read_now(lambda c: list_radio_maps(c, site_id="lab", limit=9))
    }
    grown = maps[accepted.stdout.strip()]
    assert (grown.version, grown.active) == (2, False)
    assert grown.fingerprints > 36
    assert waiting(store) < WALKS


def test_what_is_discarded_cannot_be_accepted(growth: Growth, store: Database) -> None:
    asyncio.run(keep_aside(store))
    assert growth("discard", "lab").stdout == f"{WALKS} sessions forgotten\n"
    assert waiting(store) == 0
    assert isinstance(growth("accept", "lab").exception, CommandError)


def test_a_site_that_has_not_asked_for_growth_is_told_how(growth: Growth, store: Database) -> None:
    assert "grow_map is off" in growth("look", "lab").output
    store.write_now(lambda c: insert_site(c, StoredSite("grown", "Grown", 0.0, grow_map=True)))
    assert "grow_map is off" not in growth("look", "grown").output
