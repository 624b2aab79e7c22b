import asyncio
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sample_sessions import wifi_scan
from sqlalchemy import Connection, inspect, text

from app.core.fingerprint.ageing import Change, Suspect
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.session import SessionRecord
from app.core.types import Observation
from app.storage import ageing, migrate
from app.storage.database import Database
from app.storage.engines import migrating_engine
from app.storage.log import SqlObservationLog
from app.storage.log_rows import OBSERVATIONS
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.tables import METADATA

HEAD = "0011"


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def empty_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'empty 100%.db'}"
    url: str = request.getfixturevalue("new_postgres_url")(None)
    return url


def tables_of(url: str) -> set[str]:
    engine = migrating_engine(url)
    names = set(inspect(engine).get_table_names())
    engine.dispose()
    return names - {"alembic_version"}


def test_the_migrations_make_exactly_the_tables_of_the_code(storage_url: str):
    engine = migrating_engine(storage_url)
    with engine.connect() as connection:
        # SQLite's comparison of server defaults takes '' for another default than ''.
        defaults = connection.dialect.name == "postgresql"
        context = MigrationContext.configure(connection, opts={"compare_server_default": defaults})
        differences = compare_metadata(context, METADATA)
    engine.dispose()
    assert differences == []


def test_upgrade_from_empty_and_downgrade_to_base(empty_url: str):
    assert migrate.current(empty_url) is None
    migrate.upgrade(empty_url)
    assert migrate.current(empty_url) == HEAD
    assert tables_of(empty_url) == set(METADATA.tables)
    migrate.downgrade(empty_url, "base")
    assert migrate.current(empty_url) is None
    assert tables_of(empty_url) == set()


def test_what_is_quarantined_stays_so_though_its_evidence_is_counted_otherwise(storage_url: str):
    def store(connection: Connection) -> str:
        insert_site(connection, StoredSite("hall", "Hall", 0.0))
        radio_map = build_radio_map(("F1",), [Fingerprint(0, 0.0, 0.0, {"a": -50.0}, {})])
        origin = RadioMapOrigin("m", 0.0)
        stored = save_radio_map(connection, "hall", radio_map, origin, activate=True)
        suspects = [Suspect(key, Change.MOVED, 1.5, 9, 3, 7.0) for key in "ab"]
        ageing.replace_suspects(connection, stored.radio_map_id, suspects, 1.0)
        ageing.set_quarantine(connection, stored.radio_map_id, ["a"], quarantined=True)
        return stored.radio_map_id

    database = Database(storage_url)
    radio_map_id = database.write_now(store)
    database.close_now()
    migrate.downgrade(storage_url, "0010")
    migrate.upgrade(storage_url)
    database = Database(storage_url)
    (left,) = database.read_now(lambda c: ageing.list_aged(c, radio_map_id))
    database.close_now()
    assert left.quarantined
    assert left.suspect == Suspect("a", Change.MOVED, 0.0, 9, 0, 7.0)


def test_processes_that_start_together_upgrade_once(empty_url: str):
    with ThreadPoolExecutor(6) as threads:
        list(threads.map(migrate.upgrade, [empty_url] * 6))
    assert migrate.current(empty_url) == HEAD


def test_scripts_are_found_in_an_installed_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    package = tmp_path / "app" / "storage"
    shutil.copytree(migrate.scripts_folder(), package / "migrations_bundle")
    monkeypatch.setattr(migrate, "__file__", str(package / "migrate.py"))
    assert migrate.scripts_folder() == package / "migrations_bundle"
    migrate.upgrade(f"sqlite:///{tmp_path / 'new.db'}")
    assert migrate.current(f"sqlite:///{tmp_path / 'new.db'}") == HEAD


def test_sessions_of_an_earlier_release_keep_their_event_times(empty_url: str):
    migrate.upgrade(empty_url, "0007")
    engine = migrating_engine(empty_url)
    payload = OBSERVATIONS.encode([wifi_scan(10.0)])
    with engine.begin() as connection:
        connection.execute(text("INSERT INTO sites (id, name, created_s) VALUES ('a', 'A', 0)"))
        connection.execute(text("INSERT INTO devices (id, site_id) VALUES ('p', 'a')"))
        session = (
            "INSERT INTO sessions (id, device_id, session, site_id, profile, clock_recorded, "
            "clock_offset_s, clock_mono_to_wall_s, opened_s) "
            "VALUES ('s', 'p', 'walk', 'a', 'best', false, 60.0, 7.0, 5.0)"
        )
        connection.execute(text(session))
        batch = (
            "INSERT INTO observation_batches (session_id, seq, digest, received_s, first_s, "
            "last_s, has_imu, payload, rejected, ignored) "
            "VALUES ('s', 0, :payload, 5.0, 10.0, 10.0, false, :payload, :nothing, 0)"
        )
        connection.execute(text(batch), {"nothing": OBSERVATIONS.encode([]), "payload": payload})
    engine.dispose()
    migrate.upgrade(empty_url)

    async def read() -> tuple[SessionRecord, list[Observation]]:
        database = Database(empty_url)
        log = SqlObservationLog(database)
        (record,) = await log.unfinished_sessions()
        observations = await log.observations("s")
        await database.close()
        return record, observations

    record, observations = asyncio.run(read())
    assert observations == [wifi_scan(10.0)]
    assert (record.clock.offset_s, record.clock.mono_to_wall_s) == (60.0, 7.0)
    assert record.clock.mono_seq == -1, "no batch's clock takes its place"
