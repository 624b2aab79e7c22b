import asyncio
import sqlite3
import threading
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from sqlalchemy import Connection, func, insert, select, text
from sqlalchemy.exc import DBAPIError, IntegrityError

from app.storage.database import Database, DatabaseUnavailableError
from app.storage.tables import SITES

pytestmark = pytest.mark.anyio


def add(name: str):
    def statement(connection: Connection) -> str:
        connection.execute(insert(SITES), {"id": name, "name": name, "created_s": 0.0})
        return name

    return statement


def names(connection: Connection) -> list[str]:
    return sorted(connection.scalars(select(SITES.c.id)))


class Gate:
    """A write that holds the writer, inside its transaction, until it is opened."""

    def __init__(self) -> None:
        self._open, self._reached = threading.Event(), threading.Event()

    def hold(self, _connection: Connection) -> None:
        self._reached.set()
        assert self._open.wait(10)

    async def reached(self) -> None:
        await asyncio.to_thread(self._reached.wait)

    def hold_up_loop(self) -> None:
        """Let nothing else run, not even the clock of a limit, before the writer is there."""
        assert self._reached.wait(10)

    def open(self) -> None:
        self._open.set()


@asynccontextmanager
async def held_writer(database: Database) -> AsyncIterator[None]:
    """Let writes gather in the queue; when the block ends they run as one group."""
    gate = Gate()
    held = asyncio.create_task(database.write(gate.hold))
    await gate.reached()
    yield
    gate.open()
    await held


async def queued(*writes: Coroutine[object, object, object]) -> list[asyncio.Task[object]]:
    tasks = [asyncio.create_task(write) for write in writes]
    await asyncio.sleep(0)
    return tasks


async def test_writes_return_values_and_are_seen_by_later_reads(database: Database):
    assert await asyncio.gather(*(database.write(add(f"{i}")) for i in range(30)))
    assert await database.read(names) == sorted(str(i) for i in range(30))


async def test_a_failing_write_fails_alone_in_its_group(database: Database):
    async with held_writer(database):
        group = await queued(*(database.write(add(n)) for n in ("a", "a", "b")))
        assert database.waiting == 3
    results = await asyncio.gather(*group, return_exceptions=True)
    assert [type(r) for r in results] == [str, IntegrityError, str]
    assert await database.read(names) == ["a", "b"]


async def test_half_of_a_failing_write_is_undone(database: Database):
    def half(connection: Connection) -> None:
        add("half")(connection)
        raise ValueError(connection)

    with pytest.raises(ValueError, match="Connection"):
        await database.write(half)
    assert await database.read(names) == []


async def test_waiting_writes_share_one_transaction(database: Database):
    transactions: list[object] = []
    async with held_writer(database):
        note = lambda c: transactions.append(c.get_transaction())  # noqa: E731
        group = await queued(*(database.write(note) for _ in range(5)))
    await asyncio.gather(*group)
    assert len(transactions) == 5
    assert len({id(transaction) for transaction in transactions}) == 1


async def test_nothing_is_acknowledged_before_its_commit(database: Database):
    last_of_group = Gate()
    async with held_writer(database):
        group = await queued(database.write(add("a")), database.write(last_of_group.hold))
    await last_of_group.reached()
    assert not group[0].done()
    assert await database.read(names) == []
    last_of_group.open()
    assert await group[0] == "a"
    assert await database.read(names) == ["a"]
    await group[1]


async def test_a_write_that_waits_too_long_is_refused_and_never_runs(database: Database):
    async with held_writer(database):
        with pytest.raises(DatabaseUnavailableError, match="it never runs"):
            await database.write(add("late"), timeout_s=0.01)
    await database.flush()
    assert await database.read(names) == []


async def test_a_commit_that_has_begun_may_yet_come_when_the_time_is_up(database: Database):
    gate = Gate()
    (late,) = await queued(database.write(gate.hold, timeout_s=0.0))
    gate.hold_up_loop()
    with pytest.raises(DatabaseUnavailableError, match="it may yet be stored"):
        await late
    gate.open()


async def test_a_commit_counts_when_a_held_up_loop_learns_of_it_too_late(database: Database):
    (writing,) = await queued(database.write(add("a"), timeout_s=0.0))
    # The loop stands here until the commit is done, and comes to the end of the time after that.
    database.write_now(lambda _: None)
    assert await writing == "a"


async def test_a_full_queue_refuses_and_counts_what_was_submitted(storage_url: str):
    database = Database(storage_url, queue_limit=2)
    async with held_writer(database):
        database.submit(add("a"))
        database.submit(add("b"))
        with pytest.raises(DatabaseUnavailableError):
            await database.write(add("c"))
        database.submit(add("d"))
        assert database.failed_submissions == 1
    await database.close()


async def test_submitted_writes_keep_their_order_with_others(database: Database):
    seen: list[str] = []
    async with held_writer(database):
        for name in "abc":
            database.submit(lambda _, n=name: seen.append(n))
        (last,) = await queued(database.write(lambda _: seen.append("d")))
    await last
    assert seen == ["a", "b", "c", "d"]


async def test_a_failed_submission_is_counted_and_logged(
    database: Database, caplog: pytest.LogCaptureFixture
):
    database.submit(add("a"))
    database.submit(add("a"))
    await database.flush()
    assert database.failed_submissions == 1
    assert "a submitted write failed" in caplog.text


async def test_submitted_writes_outlive_a_refused_transaction(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("app.storage.engines.BUSY_TIMEOUT_MS", 1)
    monkeypatch.setattr("app.storage.database.RETRY_AFTER_S", 0.01)
    database = Database(database_url)
    # Another process that holds the write lock makes every transaction fail.
    blocker = sqlite3.connect(tmp_path / "pharos.db", isolation_level=None)
    blocker.execute("BEGIN IMMEDIATE")
    database.submit(add("a"))
    with pytest.raises(DatabaseUnavailableError, match="locked"):
        await database.write(add("refused"))
    database.submit(add("b"))
    blocker.execute("ROLLBACK")
    blocker.close()
    await database.flush()
    assert await database.read(names) == ["a", "b"]
    assert database.failed_submissions == 0
    await database.close()


async def test_close_stores_what_waits_and_takes_no_more(storage_url: str):
    database = Database(storage_url)
    for name in "abc":
        database.submit(add(name))
    await database.close()
    with pytest.raises(DatabaseUnavailableError, match="closed"):
        await database.write(add("d"))
    again = Database(storage_url)
    assert again.read_now(names) == ["a", "b", "c"]
    again.close_now()


async def test_reading_connections_refuse_to_write(database: Database):
    with pytest.raises((DBAPIError, DatabaseUnavailableError), match=r"(?i)read-?only"):
        await database.read(add("a"))


async def test_foreign_keys_are_enforced(database: Database):
    statement = "INSERT INTO snapshots (session_id, payload) VALUES ('nobody', '')"
    with pytest.raises(IntegrityError):
        await database.write(lambda c: c.execute(text(statement)).close())


def test_the_command_line_writes_and_reads_without_a_loop(storage_url: str):
    database = Database(storage_url)
    assert database.write_now(add("a")) == "a"
    with pytest.raises(IntegrityError):
        database.write_now(add("a"))
    assert database.read_now(lambda c: c.scalar(select(func.count()).select_from(SITES))) == 1
    database.close_now()


async def test_sqlite_syncs_every_commit_to_disk(database_url: str):
    database = Database(database_url)
    pragma = lambda name: lambda c: c.scalar(text(f"PRAGMA {name}"))  # noqa: E731
    assert await database.write(pragma("synchronous")) == 2
    assert await database.write(pragma("journal_mode")) == "wal"
    await database.close()


@pytest.mark.parametrize("url", ["sqlite://", "sqlite:///:memory:", "mysql://u:secret@h/d"])
def test_urls_that_cannot_serve_are_refused(url: str):
    with pytest.raises(ValueError, match=r"SQLite needs a file|neither") as refusal:
        Database(url)
    assert "secret" not in str(refusal.value)
