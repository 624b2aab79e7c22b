"""The real engine over the real log: a walk through the warehouse, shuffled and across crashes."""

from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from session_ports import ManualClock, batch_of
from sqlalchemy import insert

from app.core import engine
from app.core.params import Params
from app.core.session import LoggedBatch, SessionClock, event_times
from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.core.site import SiteModel
from app.core.types import ImuBlock, Observation, Pedometer, Steps, TrackPoint
from app.sessions.batch import ClockReport, IncomingBatch
from app.sessions.hub import Hub
from app.sessions.limits import SessionLimits
from app.sessions.ports import SessionPorts
from app.sessions.registry import SessionRegistry
from app.storage.database import Database
from app.storage.log import SqlObservationLog
from app.storage.snapshots import SqlSnapshotStore
from app.storage.tables import FLOORS, SITES
from app.storage.tracks import SqlTrackStore, read_track

pytestmark = pytest.mark.anyio

START_S = 1_763_769_600.0
LIMITS = SessionLimits(snapshot_every_s=10.0)


@cache
def _world() -> Warehouse:
    return warehouse(seed=1)


@cache
def _walk(imu: bool) -> SimulatedWalk:
    return walk(_world(), seed=5, start_s=START_S, duration_s=40.0, imu=imu)


class WarehouseSite:
    """The warehouse as the only site."""

    def current(self, site_id: str) -> SiteModel | None:
        return _world().site if site_id == _world().site.site_id else None

    def params(self, site_id: str, profile: str) -> Params:
        return Params()


@pytest.fixture
async def database(database_url: str) -> AsyncIterator[Database]:
    opened = Database(database_url)
    site = _world().site
    site_row = {"id": site.site_id, "name": "Warehouse", "created_s": 0.0}
    floor_rows = [
        {
            "id": floor.floor_id,
            "site_id": site.site_id,
            "name": floor.name,
            "ordinal": floor.ordinal,
            "x0_m": floor.x0_m,
            "y0_m": floor.y0_m,
            "width_m": floor.width_m,
            "height_m": floor.height_m,
        }
        for floor in site.floors
    ]
    await opened.write(lambda c: c.execute(insert(SITES), site_row).close())
    await opened.write(lambda c: c.execute(insert(FLOORS), floor_rows).close())
    yield opened
    await opened.close()


class Process:
    """One life of the server on its database."""

    def __init__(self, database: Database) -> None:
        self.clock = ManualClock()
        self.log = SqlObservationLog(database)
        ports = SessionPorts(self.log, SqlSnapshotStore(database), SqlTrackStore(database))
        self.registry = SessionRegistry(ports, WarehouseSite(), Hub(), self.clock, LIMITS)

    async def live_track(self, database: Database) -> list[TrackPoint]:
        """Return what a reader of the phone's one live session sees."""
        await self.registry.settle("phone")
        (pending,) = self.registry.pending_points("phone").values()
        points = {p.time_s: p for p in (*await _stored(database), *pending)}
        return [points[t] for t in sorted(points)]

    async def finish(self) -> None:
        """Let all sessions end."""
        self.clock.time_s += LIMITS.idle_s
        await self.registry.sweep()


def _batches(observations: Sequence[Observation], size: int) -> list[IncomingBatch]:
    site_id = _world().site.site_id
    return [
        batch_of(observations[i : i + size], seq, site_id=site_id)
        for seq, i in enumerate(range(0, len(observations), size))
    ]


def _straight(observations: Sequence[Observation]) -> list[TrackPoint]:
    state, outputs, site = engine.start(), [], _world().site
    for observation in sorted(observations, key=engine.order_key):
        state, more = engine.advance(state, observation, site, Params())
        outputs += more
    outputs += engine.finish(state, site, Params())
    by_time = {o.time_s: o for o in outputs if isinstance(o, TrackPoint)}
    return [by_time[time_s] for time_s in sorted(by_time)]


def _smoothed(observations: Sequence[Observation]) -> list[TrackPoint]:
    in_order = sorted(observations, key=engine.order_key)
    return list(engine.smoothed(in_order, _world().site, Params()))


async def _stored(database: Database) -> list[TrackPoint]:
    stored = await database.read(lambda c: read_track(c, "phone", 0.0, 4e9, 10_000))
    return [s.point for s in stored]


@pytest.mark.parametrize("imu", [False, True])
async def test_the_stored_track_is_the_fold_of_the_walk(database: Database, imu: bool) -> None:
    process = Process(database)
    for batch in _batches(_walk(imu).observations, size=5):
        reply = await process.registry.submit(batch)
        assert reply.output is not None
    track = await process.live_track(database)
    assert len(track) > 30
    assert track == _straight(_walk(imu).observations)
    await process.finish()
    assert await _stored(database) == _smoothed(_walk(imu).observations)


async def test_swapped_and_repeated_batches_give_the_same_track(database: Database) -> None:
    process = Process(database)
    batches = _batches(_walk(True).observations, size=7)
    for i in range(0, len(batches) - 1, 2):
        batches[i], batches[i + 1] = batches[i + 1], batches[i]
    for batch in batches:
        first = await process.registry.submit(batch)
        again = await process.registry.submit(batch)
        assert again == replace(first, duplicate=True, observations=())
    assert await process.live_track(database) == _straight(_walk(True).observations)
    await process.finish()
    assert await _stored(database) == _smoothed(_walk(True).observations)


async def test_deaths_between_log_and_fold_change_nothing(database: Database) -> None:
    observations = list(_walk(True).observations)
    np.random.default_rng(3).shuffle(observations)  # type: ignore[arg-type]
    process = Process(database)
    for batch in _batches(observations, size=40):
        if batch.seq % 3 == 1:
            await _die_between_log_and_fold(process, batch)
            process = Process(database)
            await process.registry.recover()
            assert (await process.registry.submit(batch)).duplicate
        else:
            await process.registry.submit(batch)
    await process.registry.close()
    process = Process(database)
    await process.registry.recover()
    assert await process.live_track(database) == _straight(observations)
    await process.finish()
    assert await _stored(database) == _smoothed(observations)


async def _die_between_log_and_fold(process: Process, batch: IncomingBatch) -> None:
    append = process.log.append

    async def append_and_die(logged: LoggedBatch, clock: SessionClock) -> LoggedBatch:
        await append(logged, clock)
        raise ConnectionResetError

    process.log.append = append_and_die  # type: ignore[method-assign]
    with pytest.raises(ConnectionResetError):
        await process.registry.submit(batch)


def _held_north(time_s: float) -> ImuBlock:
    """Return a second of a phone that points north and feels no steps."""
    acc_mps2 = np.tile(np.array([0.0, 0.0, 9.81], dtype=np.float32), (10, 1))
    quat_wxyz = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (10, 1))
    none = np.empty((0, 3), dtype=np.float32)
    return ImuBlock(time_s, 10.0, acc_mps2, none, none, quat_wxyz)


async def test_a_pedometer_interval_posted_live_at_its_end_is_in_time(database: Database) -> None:
    scans = [o for o in _walk(False).observations if not isinstance(o, Steps)]
    scans = [o for o in scans if o.time_s < START_S + 10]
    process = Process(database)
    replies = []
    for seq in range(12):
        posted_s = START_S + 1 + seq
        heard: list[Observation] = [o for o in scans if posted_s - 1 <= o.time_s < posted_s]
        heard.append(_held_north(posted_s - 1))
        if seq == 10:
            heard.append(Pedometer(posted_s - 10, posted_s, 15, 10.5))
        batch = batch_of(
            heard,
            seq,
            site_id=_world().site.site_id,
            received_s=posted_s,
            clock=ClockReport(sent_s=posted_s),
        )
        replies.append(await process.registry.submit(batch))
    stood, walked = replies[9].output, replies[10].output
    assert isinstance(stood, TrackPoint)
    assert isinstance(walked, TrackPoint)
    assert (walked.time_s, walked.used.steps) == (START_S + 11, 15)
    assert walked.y_m > stood.y_m + 5.0
    # Nothing was too late for the window: nobody settles, and the track is that of the sorted log.
    (pending,) = process.registry.pending_points("phone").values()
    batches = await process.log.read(replies[0].session_id)
    logged = list(event_times(batches, SessionClock()))
    points = {p.time_s: p for p in (*await _stored(database), *pending)}
    assert [points[t] for t in sorted(points)] == _straight(logged)


async def test_settling_completes_the_track_of_a_live_session(database: Database) -> None:
    observations = _walk(False).observations
    half = len(observations) // 2
    process = Process(database)
    for batch in _batches(observations[:half], size=5):
        await process.registry.submit(batch)
    process = Process(database)
    await process.registry.recover()
    await process.registry.settle("phone")
    (pending,) = process.registry.pending_points("phone").values()
    points = {p.time_s: p for p in (*await _stored(database), *pending)}
    assert [points[t] for t in sorted(points)] == _straight(observations[:half])


async def test_a_finished_session_is_opened_again(database: Database) -> None:
    observations = _walk(False).observations
    half = len(observations) // 2
    batches = _batches(observations, size=half)
    process = Process(database)
    await process.registry.submit(batches[0])
    await process.finish()
    for batch in batches[1:]:
        await process.registry.submit(batch)
    assert len(await process.log.unfinished_sessions()) == 1
    await process.finish()
    assert await process.log.unfinished_sessions() == []
    assert await _stored(database) == _smoothed(observations)
