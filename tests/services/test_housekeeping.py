"""What is forgotten when: a site's own retention, and the server's where a site says nothing."""

import asyncio
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sqlalchemy import Connection
from wifi_hall import SIDE_M, levels_dbm

from app.core.fingerprint.ageing import Change
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.session import LoggedBatch, SessionClock, SessionRecord
from app.core.types import BleScan, Method, MotionMode, Reading, TrackPoint, Used, WifiScan
from app.services.ageing import AgeingService
from app.services.housekeeping import Housekeeping, Retention
from app.services.site import SiteDirectory
from app.sessions.hub import Hub
from app.sessions.ports import SessionPorts
from app.sessions.registry import SessionRegistry
from app.storage.ageing import list_aged
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.log import SqlObservationLog
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.snapshots import SqlSnapshotStore
from app.storage.tracks import SqlTrackStore, read_track

DAY_S = 86_400.0
NOW_S = 1_795_314_000.0
AGES_DAYS = (5, 20, 100)
POINT = TrackPoint(
    *(0.0, "floor", 1.0, 2.0, (1.0, 0.0, 1.0), 2.5, 0.0, None),
    *(MotionMode.STILL, Method.LATERATION, 1.0, Used(), 0.0),
)


class Clock:
    """A clock that stands still."""

    def now_s(self) -> float:
        return NOW_S


def _insert_sites(connection: Connection) -> None:
    insert_site(connection, StoredSite("strict", "Strict", 0.0, retention_days=10.0))
    insert_site(connection, StoredSite("silent", "Silent", 0.0))


async def _walk(log: SqlObservationLog, tracks: SqlTrackStore, site_id: str) -> None:
    opened_s = NOW_S - 101 * DAY_S
    clock = SessionClock(recorded=False)
    record = SessionRecord(site_id, site_id, "walk", site_id, "best", clock, opened_s)
    await log.open_session(record)
    for seq, days in enumerate(AGES_DAYS):
        time_s = NOW_S - days * DAY_S
        await log.append(LoggedBatch(site_id, seq, b"", time_s, (BleScan(time_s, ()),)), clock)
        tracks.write(site_id, [replace(POINT, time_s=time_s)])
    await log.finish_session(site_id)


@pytest.mark.anyio
async def test_each_site_keeps_scans_and_tracks_for_its_own_time(database_url: str) -> None:
    database = Database(database_url)
    await database.write(_insert_sites)
    log, tracks = SqlObservationLog(database), SqlTrackStore(database)
    for site_id in ("strict", "silent"):
        await _walk(log, tracks, site_id)
    directory = SiteDirectory(database)
    ports = SessionPorts(log, SqlSnapshotStore(database), tracks)
    registry = SessionRegistry(ports, directory, Hub(), Clock())
    retention = Retention(kept_s=50 * DAY_S)
    await Housekeeping(
        registry, directory, database, Clock(), retention, AgeingService(database)
    ).round()
    left = {}
    for site_id in ("strict", "silent"):
        points = await database.read(partial(read_track, device_id=site_id, **_ALL))
        batches = await log.read(site_id)
        assert all(batch.observations for batch in batches)
        scans = [o.time_s for b in batches for o in b.observations]
        assert sorted(scans) == [p.point.time_s for p in points]
        left[site_id] = [round((NOW_S - time_s) / DAY_S) for time_s in scans]
    await database.close()
    assert left == {"strict": [5], "silent": [5, 20]}


_ALL = {"from_s": 0.0, "to_s": 1e10, "limit": 100}


class FaultyClock:
    """A clock that fails once; then it tells that somebody asked again."""

    def __init__(self) -> None:
        self.asked = asyncio.Event()
        self._failed = False

    def now_s(self) -> float:
        if not self._failed:
            self._failed = True
            message = "no time"
            raise RuntimeError(message)
        self.asked.set()
        return NOW_S


@pytest.mark.anyio
async def test_a_round_that_fails_is_told_and_the_next_goes_on(
    database_url: str, caplog: pytest.LogCaptureFixture
) -> None:
    database = Database(database_url)
    directory, clock = SiteDirectory(database), FaultyClock()
    log, tracks = SqlObservationLog(database), SqlTrackStore(database)
    registry = SessionRegistry(
        SessionPorts(log, SqlSnapshotStore(database), tracks), directory, Hub(), clock
    )
    housekeeping = Housekeeping(
        registry, directory, database, clock, Retention(), AgeingService(database)
    )
    chores = asyncio.create_task(housekeeping.run(0.0))
    await asyncio.wait_for(clock.asked.wait(), 10.0)
    chores.cancel()
    assert "no time" in caplog.text
    await asyncio.gather(chores, return_exceptions=True)
    await database.close()


class MovableClock:
    """A clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.time_s = NOW_S

    def now_s(self) -> float:
        return self.time_s


def _mapped_hall(connection: Connection) -> str:
    rng = np.random.default_rng(1)
    grid = np.arange(0.0, SIDE_M + 1.0, 8.0).tolist()
    surveyed = [
        Fingerprint(0, x, y, levels_dbm(x, y, rng), {}, f"row-{y:.0f}") for y in grid for x in grid
    ]
    insert_site(connection, StoredSite("hall", "Hall", 0.0))
    insert_floor(connection, StoredFloor("hall-F1", "hall", "F1", 0, SIDE_M, SIDE_M))
    radio_map = build_radio_map(("hall-F1",), surveyed)
    origin = RadioMapOrigin("survey", NOW_S - DAY_S)
    return save_radio_map(connection, "hall", radio_map, origin, activate=True).radio_map_id


@pytest.mark.anyio
async def test_radio_maps_are_held_against_traffic_once_a_day(database_url: str) -> None:
    database = Database(database_url)
    radio_map_id = await database.write(_mapped_hall)
    log, directory, clock = SqlObservationLog(database), SiteDirectory(database), MovableClock()
    ports = SessionPorts(log, SqlSnapshotStore(database), SqlTrackStore(database))
    registry = SessionRegistry(ports, directory, Hub(), clock)
    housekeeping = Housekeeping(
        registry, directory, database, clock, Retention(), AgeingService(database)
    )
    session = SessionRecord("s", "phone", "walk", "hall", "best", SessionClock(True), NOW_S)
    await log.open_session(session)
    told = []
    for seq, hours in enumerate((0.0, 23.0, 24.0, 47.0, 49.0)):
        clock.time_s = NOW_S + hours * 3600.0
        # One more newcomer is heard often enough each time: what is listed says when was looked.
        scans = tuple(
            WifiScan(
                clock.time_s + i,
                tuple(
                    Reading((key,), level_dbm)
                    for key, level_dbm in {**levels_dbm(9.0, 9.0), f"mac:new-{seq}": -50.0}.items()
                ),
            )
            for i in range(5)
        )
        await log.append(LoggedBatch("s", seq, b"", clock.time_s, scans), session.clock)
        await housekeeping.round()
        aged = await database.read(partial(list_aged, radio_map_id=radio_map_id))
        told.append(sorted(a.suspect.key for a in aged if a.suspect.change is Change.APPEARED))
    await database.close()
    first, after_a_day, after_two = ([f"mac:new-{i}" for i in range(n)] for n in (1, 3, 5))
    assert told == [first, first, after_a_day, after_a_day, after_two]
