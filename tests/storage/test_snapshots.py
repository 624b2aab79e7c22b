import pytest
from sample_sessions import session_record, track_point
from sqlalchemy import select, update

from app.core.engine import SessionState
from app.core.engine.order import Content
from app.storage.database import Database
from app.storage.log import SqlObservationLog
from app.storage.snapshots import SqlSnapshotStore
from app.storage.tables import SNAPSHOTS, TRACK_POINTS
from app.storage.tracks import SqlTrackStore

pytestmark = pytest.mark.anyio


@pytest.fixture
async def store(database: Database, site: str) -> SqlSnapshotStore:
    await SqlObservationLog(database).open_session(session_record())
    return SqlSnapshotStore(database)


def state(latest_s: float) -> SessionState:
    return SessionState(last_key=(latest_s, 6, Content(b"\x00\x01")), latest_s=latest_s)


async def test_the_last_snapshot_is_loaded(store: SqlSnapshotStore):
    assert await store.load("s-1", "best") is None
    await store.save("s-1", "best", state(1.0))
    await store.save("s-1", "best", state(2.1))
    loaded = await store.load("s-1", "best")
    assert repr(loaded) == repr(state(2.1))
    assert await store.load("s-2", "best") is None
    assert await store.load("s-1", "other") is None


async def test_the_snapshot_of_another_build_is_not_used(
    store: SqlSnapshotStore, database: Database
):
    await store.save("s-1", "best", state(1.0))
    await database.write(lambda c: c.execute(update(SNAPSHOTS).values(payload=b"\x02old")).close())
    assert await store.load("s-1", "best") is None


async def test_points_written_before_a_snapshot_are_stored_with_it(
    store: SqlSnapshotStore, database: Database
):
    SqlTrackStore(database).write("s-1", [track_point(1.0)])
    await store.save("s-1", "best", state(1.0))
    assert await database.read(lambda c: c.scalar(select(TRACK_POINTS.c.time_us))) == 1_000_000
