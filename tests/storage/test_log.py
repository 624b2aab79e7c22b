import asyncio
import dataclasses
import os
import signal
import subprocess
import sys
import textwrap
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sample_sessions import CLOCK, imu_block, logged_batch, session_record, wifi_scan
from sqlalchemy import select

from app.core import engine
from app.core.session import LogUnavailableError, Rejection, SessionClock
from app.core.types import Barometer, ImuBlock
from app.storage.database import Database
from app.storage.log import SqlObservationLog
from app.storage.log_rows import OBSERVATIONS
from app.storage.retention import purge_imu, purge_observations
from app.storage.snapshots import SqlSnapshotStore
from app.storage.tables import DEVICES, OBSERVATION_BATCHES

pytestmark = pytest.mark.anyio


@pytest.fixture
async def log(database: Database, site: str) -> SqlObservationLog:
    log = SqlObservationLog(database)
    await log.open_session(session_record())
    return log


async def test_a_session_is_opened_once_by_the_phones_names(log: SqlObservationLog):
    again = dataclasses.replace(session_record(), session_id="other", profile="static")
    assert await log.open_session(again) == session_record()
    of_another_phone = dataclasses.replace(again, device_id="phone-2")
    of_another_name = dataclasses.replace(again, session_id="third", session="another run")
    for other in (of_another_phone, of_another_name):
        assert await log.open_session(other) == other


async def test_opening_a_session_registers_its_device_once(
    log: SqlObservationLog, database: Database
):
    await log.open_session(session_record("s-2", opened_s=200.0))
    rows = await database.read(lambda c: c.execute(select(DEVICES)).all())
    assert [(r.id, r.site_id, r.first_seen_s) for r in rows] == [("phone-1", "site-1", 100.0)]


async def test_unfinished_sessions_are_listed_oldest_first(log: SqlObservationLog):
    older = await log.open_session(session_record("s-0", "phone-2", opened_s=50.0))
    done = await log.open_session(session_record("s-9", "phone-2", opened_s=60.0))
    await log.finish_session(done.session_id)
    assert await log.unfinished_sessions() == [older, session_record()]
    assert (await log.open_session(done)).finished


async def test_a_batch_comes_back_exactly_as_it_was_appended(log: SqlObservationLog):
    batch = dataclasses.replace(
        logged_batch(2**40, wifi_scan(10.1)),
        rejected=(Rejection(3, "rssi_out_of_range", "/records/3/rssi", "0 dBm"),),
        ignored=4,
    )
    assert await log.append(batch, CLOCK) == batch
    assert await log.read("s-1") == [batch]


async def test_of_a_known_seq_the_stored_batch_is_returned_and_kept(log: SqlObservationLog):
    first = await log.append(logged_batch(1, wifi_scan(10.0)), CLOCK)
    other = dataclasses.replace(logged_batch(1, wifi_scan(99.0)), digest=b"other")
    assert await log.append(other, CLOCK) == first
    assert await log.read("s-1") == [first]


async def test_the_same_seq_at_the_same_time_is_stored_once(log: SqlObservationLog):
    batches = [
        dataclasses.replace(logged_batch(1, wifi_scan(10.0)), digest=bytes([i])) for i in range(5)
    ]
    assert set(await asyncio.gather(*(log.append(batch, CLOCK) for batch in batches))) == {
        batches[0]
    }


async def test_batches_are_read_in_the_order_of_arrival_not_of_seq(log: SqlObservationLog):
    for seq in (3, 1, 2):
        await log.append(logged_batch(seq, wifi_scan(float(seq))), CLOCK)
    assert [b.seq for b in await log.read("s-1")] == [3, 1, 2]
    assert await log.read("s-2") == []


async def test_reading_since_an_instant_leaves_out_what_ended_before(log: SqlObservationLog):
    await log.append(logged_batch(1, wifi_scan(10.0), wifi_scan(19.0)), CLOCK)
    # 51 samples at 50 Hz: the block speaks of 19.0 to 20.0 s.
    await log.append(logged_batch(2, imu_block(19.0, samples=51)), CLOCK)
    await log.append(logged_batch(3), CLOCK)
    assert [b.seq for b in await log.read("s-1", since_s=19.0)] == [1, 2]
    assert [b.seq for b in await log.read("s-1", since_s=20.0)] == [2]
    assert [b.seq for b in await log.read("s-1", since_s=20.1)] == []
    assert [b.seq for b in await log.read("s-1")] == [1, 2, 3]


async def test_batches_span_the_event_times_of_the_clock_as_it_is_settled(
    log: SqlObservationLog, database: Database
):
    told = session_record("s-2", "phone-2")
    record = dataclasses.replace(told, clock=SessionClock(recorded=True))
    await log.open_session(record)
    by_mono = dataclasses.replace(
        logged_batch(1, wifi_scan(10.0), wifi_scan(40.0), session_id="s-2"),
        monotonic=(True, False),
    )
    waiting = dataclasses.replace(
        logged_batch(2, wifi_scan(10.0), session_id="s-2"), monotonic=(True,)
    )
    for batch in (by_mono, waiting):
        await log.append(batch, record.clock)
    snapshots = SqlSnapshotStore(database)
    await snapshots.save("s-2", "best", engine.start())
    assert [b.seq for b in await log.read("s-2", since_s=40.0)] == [1]
    assert await log.observations("s-2") == [wifi_scan(40.0)]
    settled = dataclasses.replace(record, clock=SessionClock(True, None, None, 90.0, 1))
    await log.settle_clock(settled)
    assert [b.seq for b in await log.read("s-2", since_s=100.0)] == [1, 2]
    assert await log.read("s-2") == [by_mono, waiting]
    assert await log.observations("s-2") == [wifi_scan(40.0), wifi_scan(100.0)]
    assert await snapshots.load("s-2", "best") is None
    assert settled in await log.unfinished_sessions()
    # Another seq that tells the same leaves all times, and the snapshot, as they are.
    await snapshots.save("s-2", "best", engine.start())
    same = dataclasses.replace(record, clock=SessionClock(True, None, None, 90.0, 0))
    await log.settle_clock(same)
    assert await snapshots.load("s-2", "best") is not None
    assert same in await log.unfinished_sessions()


async def test_what_an_earlier_release_logged_is_in_event_time_already(
    log: SqlObservationLog, database: Database
):
    live = dataclasses.replace(
        session_record("s-2", "phone-2"), clock=SessionClock(ahead_s=60.0, mono_to_wall_s=7.0)
    )
    await log.open_session(live)
    frozen = dataclasses.replace(logged_batch(1, wifi_scan(10.0), session_id="s-2"), monotonic=None)
    await log.append(frozen, live.clock)
    assert await log.read("s-2", since_s=10.0) == [frozen]
    assert await log.observations("s-2") == [wifi_scan(10.0)]


async def test_purged_batches_keep_whose_clock_timed_what_is_left(
    log: SqlObservationLog, database: Database
):
    batch = dataclasses.replace(
        logged_batch(1, imu_block(10.0), wifi_scan(20.0), wifi_scan(30.0)),
        monotonic=(False, True, False),
    )
    await log.append(batch, CLOCK)
    await log.finish_session("s-1")
    assert await purge_imu(database, before_s=2e9) == 1
    (left,) = await log.read("s-1")
    assert left.observations == (wifi_scan(20.0), wifi_scan(30.0))
    assert left.monotonic == (True, False)


async def test_a_log_that_cannot_be_written_in_time_says_so(log: SqlObservationLog, database):
    slow = SqlObservationLog(database, limit_s=0.0)
    told = threading.Event()
    database.submit(lambda _: told.wait(10) and None)
    with pytest.raises(LogUnavailableError, match="no commit within"):
        await slow.append(logged_batch(1, wifi_scan(10.0)), CLOCK)
    told.set()
    await database.close()
    with pytest.raises(LogUnavailableError, match="closed"):
        await log.append(logged_batch(1, wifi_scan(10.0)), CLOCK)


async def contents(log: SqlObservationLog, session_id: str) -> dict[int, list[str]]:
    batches = await log.read(session_id)
    return {b.seq: [type(o).__name__ for o in b.observations] for b in batches}


async def test_raw_imu_leaves_finished_sessions_only(log: SqlObservationLog, database: Database):
    await log.open_session(session_record("s-2", "phone-2"))
    scan = wifi_scan(11.0)
    for session_id in ("s-1", "s-2"):
        for seq, received_s in ((1, 100.0), (2, 200.0)):
            batch = logged_batch(seq, imu_block(10.0), scan, session_id=session_id)
            await log.append(dataclasses.replace(batch, received_s=received_s), CLOCK)
    await log.finish_session("s-1")
    assert await purge_imu(database, before_s=150.0) == 1
    assert await purge_imu(database, before_s=150.0) == 0
    assert await contents(log, "s-1") == {1: ["WifiScan"], 2: ["ImuBlock", "WifiScan"]}
    assert (await contents(log, "s-2"))[1] == ["ImuBlock", "WifiScan"]
    assert (await log.read("s-1"))[0].observations == (scan,)
    # What is left still answers by time, and a retry still finds its seq.
    assert [b.seq for b in await log.read("s-1", since_s=11.0)] == [1, 2]
    assert (await log.append(logged_batch(1, scan), CLOCK)).received_s == 100.0


async def test_purging_goes_on_over_many_strides(
    log: SqlObservationLog, database: Database, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("app.storage.retention.PURGE_STRIDE", 2)
    await asyncio.gather(*(log.append(logged_batch(i, imu_block(1.0)), CLOCK) for i in range(5)))
    await log.finish_session("s-1")
    assert await purge_imu(database, before_s=2e9) == 5
    assert await contents(log, "s-1") == {i: [] for i in range(5)}


async def test_after_a_sites_retention_its_batches_are_empty_but_known(
    log: SqlObservationLog, database: Database
):
    old = dataclasses.replace(
        logged_batch(1, wifi_scan(1.0), Barometer(1.0, 1000.0)), received_s=10.0
    )
    young = dataclasses.replace(logged_batch(2, wifi_scan(2.0)), received_s=90.0)
    await log.append(old, CLOCK)
    await log.append(young, CLOCK)
    # The session was opened at 100 s, and can be opened again.
    purge = partial(purge_observations, database, before_s=50.0, over_s=100.0)
    assert await purge("site-1") == 0
    await log.finish_session("s-1")
    assert await purge("site-2") == 0
    assert await purge("site-1") == 1
    assert await purge("site-1") == 0
    emptied = dataclasses.replace(old, observations=())
    assert await log.read("s-1") == [emptied, young]
    assert await log.append(old, CLOCK) == emptied
    of_old = select(OBSERVATION_BATCHES).where(OBSERVATION_BATCHES.c.seq == 1)
    row = await database.read(lambda c: c.execute(of_old).one())
    assert (row.first_s, row.last_s, row.has_imu) == (None, None, False)


async def test_batches_of_a_session_that_is_over_for_good_are_removed(
    log: SqlObservationLog, database: Database, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("app.storage.retention.PURGE_STRIDE", 2)
    await log.open_session(session_record("s-2", "phone-2", opened_s=101.0))
    for session_id in ("s-1", "s-2"):
        for seq, received_s in enumerate((110.0, 120.0, 130.0, 900.0)):
            batch = logged_batch(seq, wifi_scan(received_s), session_id=session_id)
            await log.append(dataclasses.replace(batch, received_s=received_s), CLOCK)
    purge = partial(purge_observations, database, "site-1", before_s=500.0)
    assert await purge(over_s=101.0) == 0
    await log.finish_session("s-1")
    await log.finish_session("s-2")
    # First emptied while it could be opened again, then removed with what was emptied before.
    assert await purge(over_s=100.0) == 6
    assert list(await contents(log, "s-1")) == [0, 1, 2, 3]
    assert await purge(over_s=101.0) == 3
    assert await contents(log, "s-1") == {3: ["WifiScan"]}
    assert await contents(log, "s-2") == {0: [], 1: [], 2: [], 3: ["WifiScan"]}
    assert await purge(over_s=101.0) == 0


def test_an_imu_batch_takes_little_more_than_its_samples():
    block: ImuBlock = imu_block(1.0, samples=100)
    raw = sum(a.nbytes for a in (block.acc_mps2, block.gyro_radps, block.mag_ut, block.quat_wxyz))
    assert len(OBSERVATIONS.encode([block])) < raw + 200


CHILD = """
    import asyncio, sys
    from sample_sessions import CLOCK, logged_batch, session_record, wifi_scan
    from app.storage.database import Database
    from app.storage.log import SqlObservationLog

    async def phone(log, first):
        for seq in range(first, 10**9, 8):
            batch = await log.append(logged_batch(seq, wifi_scan(float(seq))), CLOCK)
            print(batch.seq, flush=True)

    async def main(url):
        log = SqlObservationLog(Database(url))
        await log.open_session(session_record())
        await asyncio.gather(*(phone(log, first) for first in range(8)))

    asyncio.run(main(sys.argv[1]))
"""


def acknowledged_before_kill_9(url: str) -> list[int]:
    """Let a child append until it has acknowledged 200 batches, kill it, return all it said."""
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(CHILD), url],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{Path(__file__).parent}:{Path(__file__).parents[2]}"},
    )
    assert child.stdout is not None
    with child.stdout as said:
        acknowledged = [int(said.readline()) for _ in range(200)]
        os.kill(child.pid, signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
        # Lines that were on their way; the last may have been cut.
        return acknowledged + [int(line) for line in said.read().split("\n")[:-1]]


@pytest.mark.usefixtures("site")
async def test_what_was_acknowledged_survives_kill_9(database: Database, storage_url: str):
    acknowledged = await asyncio.to_thread(acknowledged_before_kill_9, storage_url)
    stored = {b.seq: b for b in await SqlObservationLog(database).read("s-1")}
    assert set(acknowledged) <= set(stored)
    last = acknowledged[-1]
    assert stored[last] == logged_batch(last, wifi_scan(float(last)))


def test_imu_blocks_are_equal_sample_for_sample_after_the_log():
    block = imu_block(1.0)
    (decoded,) = OBSERVATIONS.decode(OBSERVATIONS.encode([block]))
    np.testing.assert_array_equal(decoded.acc_mps2, block.acc_mps2)
