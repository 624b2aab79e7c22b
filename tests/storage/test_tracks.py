import math
import struct
from dataclasses import astuple, replace

import pytest
from sample_sessions import session_record, track_point

from app.core.session import LastPoint, SessionClock
from app.core.types import TrackPoint
from app.storage.database import Database
from app.storage.log import SqlObservationLog
from app.storage.tracks import (
    SqlTrackStore,
    StoredPoint,
    TrackCursor,
    fixes_at,
    purge_tracks,
    read_track,
)

pytestmark = pytest.mark.anyio


def bits(point: TrackPoint) -> list[object]:
    flat = [*astuple(point)]
    flat[4:5] = point.covariance_m2
    return [struct.pack(">d", v).hex() if isinstance(v, float) else v for v in flat]


@pytest.fixture
async def sink(database: Database, site: str) -> SqlTrackStore:
    log = SqlObservationLog(database)
    await log.open_session(session_record("s-1", "phone-1", opened_s=1.0))
    await log.open_session(session_record("s-2", "phone-1", opened_s=2.0))
    await log.open_session(session_record("s-3", "phone-2", opened_s=3.0))
    return SqlTrackStore(database)


async def track(
    database: Database,
    device_id: str = "phone-1",
    from_s: float = 0.0,
    to_s: float = 1e10,
    limit: int = 1000,
    after: TrackCursor | None = None,
) -> list[StoredPoint]:
    return await database.read(lambda c: read_track(c, device_id, from_s, to_s, limit, after))


def times(points: list[StoredPoint]) -> list[tuple[float, str]]:
    return [(p.point.time_s, p.session_id) for p in points]


async def test_points_come_back_bit_for_bit(sink: SqlTrackStore, database: Database):
    points = [
        track_point(1_700_000_000.1, x_m=-0.0),
        replace(track_point(1_700_000_001.0), heading_rad=None, radius95_m=math.inf, zones=()),
        replace(track_point(1_700_000_002.0), heading_rad=-0.0, x_m=2.0, speed_mps=1e-310),
    ]
    sink.write("s-1", points)
    await sink.flush()
    stored = await track(database)
    assert [p.device_id for p in stored] == ["phone-1"] * 3
    assert [bits(p.point) for p in stored] == [bits(p) for p in points]
    assert [p.point for p in stored] == points


async def test_a_point_of_the_same_time_replaces_the_stored_one(
    sink: SqlTrackStore, database: Database
):
    sink.write("s-1", [track_point(10.0, x_m=1.0), track_point(11.0)])
    sink.write("s-1", [track_point(10.0, x_m=2.0)])
    sink.write("s-2", [track_point(10.0, x_m=3.0)])
    sink.write("s-2", [])
    await sink.flush()
    stored = await track(database)
    assert times(stored) == [(10.0, "s-1"), (10.0, "s-2"), (11.0, "s-1")]
    assert [p.point.x_m for p in stored] == [2.0, 3.0, 1.0]


async def test_replacing_from_an_instant_removes_later_points_of_that_session(
    sink: SqlTrackStore, database: Database
):
    sink.write("s-1", [track_point(t) for t in (10.0, 11.0, 12.0, 12.4)])
    sink.write("s-2", [track_point(13.0)])
    sink.replace_from("s-1", 11.0, [track_point(11.5)])
    sink.replace_from("s-2", 20.0, [])
    await sink.flush()
    assert times(await track(database)) == [(10.0, "s-1"), (11.5, "s-1"), (13.0, "s-2")]


async def test_pages_of_a_track_join_without_gap_or_repeat(sink: SqlTrackStore, database: Database):
    sink.write("s-1", [track_point(float(t)) for t in range(5)])
    sink.write("s-2", [track_point(float(t)) for t in range(3, 8)])
    await sink.flush()
    whole = times(await track(database))
    assert len(whole) == 10
    paged: list[StoredPoint] = []
    while page := await track(database, limit=3, after=paged[-1].cursor if paged else None):
        paged += page
    assert times(paged) == whole


async def test_a_track_is_cut_to_its_device_and_both_ends(sink: SqlTrackStore, database: Database):
    sink.write("s-1", [track_point(float(t)) for t in range(5)])
    sink.write("s-3", [track_point(2.0)])
    await sink.flush()
    assert times(await track(database, from_s=1.0, to_s=3.0)) == [
        (1.0, "s-1"),
        (2.0, "s-1"),
        (3.0, "s-1"),
    ]
    assert times(await track(database, "phone-2")) == [(2.0, "s-3")]
    assert times(await track(database, "phone-3")) == []


async def test_fixes_at_an_instant_are_the_latest_of_each_device(
    sink: SqlTrackStore, database: Database
):
    sink.write("s-1", [track_point(10.0), track_point(11.0), track_point(15.0)])
    sink.write("s-2", [track_point(11.0, x_m=7.0, floor_id="F2")])
    sink.write("s-3", [track_point(9.0)])
    await sink.flush()

    async def at(at_s: float, max_age_s: float, site_id: str = "site-1"):
        found = await database.read(lambda c: fixes_at(c, site_id, at_s, max_age_s))
        return [(f.device_id, f.point.time_s, f.point.x_m) for f in found]

    assert await at(12.0, 10.0) == [("phone-1", 11.0, 7.0), ("phone-2", 9.0, 1.0)]
    assert await at(12.0, 2.0) == [("phone-1", 11.0, 7.0)]
    assert await at(15.0, 10.0) == [("phone-1", 15.0, 1.0), ("phone-2", 9.0, 1.0)]
    assert await at(5.0, 2.0) == []
    assert await at(12.0, 10.0, "site-2") == []


async def test_last_points_are_the_ends_of_the_devices_newest_sessions_with_a_track(
    sink: SqlTrackStore, database: Database
):
    assert await sink.last_points() == []
    sink.write("s-1", [track_point(30.0)])
    sink.write("s-2", [track_point(10.0), track_point(11.0, x_m=7.0)])
    sink.write("s-3", [track_point(9.0, floor_id="F2")])
    await SqlObservationLog(database).open_session(session_record("s-4", "phone-2", opened_s=4.0))
    await sink.flush()
    assert sorted(await sink.last_points(), key=lambda last: last.device_id) == [
        LastPoint("phone-1", "s-2", "site-1", track_point(11.0, x_m=7.0)),
        LastPoint("phone-2", "s-3", "site-1", track_point(9.0, floor_id="F2")),
    ]


async def test_retention_takes_old_points_and_recordings_posted_long_ago(
    sink: SqlTrackStore, database: Database, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("app.storage.tracks.PURGE_STRIDE", 2)
    log = SqlObservationLog(database)
    live = SessionClock(recorded=False)
    for name, opened_s, clock in (
        ("live", 10.0, live),
        ("unfinished", 10.0, live),
        ("old recording", 10.0, SessionClock(recorded=True)),
        ("new recording", 110.0, SessionClock(recorded=True)),
    ):
        record = replace(session_record(name, name, opened_s), clock=clock)
        await log.open_session(record)
        sink.write(name, [track_point(t) for t in (20.0, 98.0, 99.0, 100.0, 120.0)])
        if name != "unfinished":
            await log.finish_session(name)
    await sink.flush()
    assert await purge_tracks(database, "site-2", 100.0) == 0
    assert await purge_tracks(database, "site-1", 100.0) == 3 + 5
    left = {name: len(await track(database, name)) for name in ("live", "old recording")}
    assert left == {"live": 2, "old recording": 0}
    kept = {name: len(await track(database, name)) for name in ("unfinished", "new recording")}
    assert kept == {"unfinished": 5, "new recording": 5}
    assert [p.point.time_s for p in await track(database, "live")] == [100.0, 120.0]
