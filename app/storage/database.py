"""The database: one writer thread that commits in groups, and a few reading connections.

Every write of the process goes through one queue, in the order of the calls. The writer takes all
that wait (up to a limit), runs each in a savepoint of one transaction and commits once: while one
commit waits for the disk, the next group gathers. A caller is answered only after the commit.
"""

import asyncio
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from app.storage.engines import reading_engine, writing_engine

T = TypeVar("T")
Statement = Callable[[Connection], T]

_log = logging.getLogger(__name__)

# How long the writer waits before it tries again to store what was submitted, after the database
# refused a whole group: long enough not to spin, short beside the seconds an outage lasts.
RETRY_AFTER_S = 0.5


class DatabaseUnavailableError(Exception):
    """The database does not answer, or not in time; nothing says that a write was stored."""


@dataclass(frozen=True, slots=True)
class _Write:
    """One function waiting for the writer; ``keep`` ones outlive a refused group."""

    run: Statement[Any]
    done: Future[Any]
    keep: bool


class Database:
    """Ordered, group-committed writes and concurrent reads of one SQLite or PostgreSQL database.

    Parameters
    ----------
    url
        ``sqlite:///path/to/file`` or ``postgresql+psycopg://...``.
    queue_limit
        Writes that may wait; further ones are refused with `DatabaseUnavailableError`.
    group_limit
        Most writes in one transaction, which bounds how long the first of them waits.
    readers
        Concurrent reads.
    edit_wait_s
        How long an edit waits for its commit, behind the observation log's groups.
    """

    def __init__(
        self,
        url: str,
        *,
        queue_limit: int = 20_000,
        group_limit: int = 256,
        readers: int = 4,
        edit_wait_s: float = 5.0,
    ) -> None:
        self.edit_wait_s = edit_wait_s
        self._writing = writing_engine(url)
        self._reading = reading_engine(url, readers)
        self._readers = ThreadPoolExecutor(readers, thread_name_prefix="pharos-read")
        self._queue: deque[_Write] = deque()
        self._wake = threading.Condition()
        self._queue_limit = queue_limit
        self._group_limit = group_limit
        self._closing = False
        self.failed_submissions = 0
        self._writer = threading.Thread(target=self._run, name="pharos-write", daemon=True)
        self._writer.start()

    @property
    def waiting(self) -> int:
        """Return how many writes wait."""
        return len(self._queue)

    async def write(self, statement: Statement[T], timeout_s: float | None = None) -> T:
        """Run ``statement(connection)`` in the writer and return its value once it is committed.

        ``timeout_s`` is of the clock on the wall, whoever is slow: the disk, another process's
        lock, the writes before this one, or a machine that lets neither thread run.

        Raises
        ------
        DatabaseUnavailableError
            If the commit did not come within ``timeout_s``, was refused, or the queue is full.
        """
        future = self._enqueue(statement, keep=False)
        with _outages():
            try:
                # A write that is still waiting when the time is up is cancelled and never runs.
                async with asyncio.timeout(timeout_s):
                    return await asyncio.wrap_future(future)
            except TimeoutError as error:
                # A loop that was held up learns of the commit and of the time together; what is
                # stored must not be told as lost.
                if future.done() and not future.cancelled():
                    return future.result()
                fate = "it never runs" if future.cancelled() else "it may yet be stored"
                msg = f"no commit within {timeout_s} s; {fate}"
                raise DatabaseUnavailableError(msg) from error

    async def write_in_strides(self, stride: Statement[int]) -> int:
        """Run ``stride(connection)``, which changes a bounded number of rows, until none is left.

        Returns how many were changed. Other writes come in between.
        """
        changed = 0
        while step := await self.write(stride):
            changed += step
        return changed

    def write_now(self, statement: Statement[T]) -> T:
        """Do the same as `write` for callers without an event loop."""
        return self._enqueue(statement, keep=False).result()

    def submit(self, statement: Statement[None]) -> None:
        """Queue a write nobody waits for; it is tried until the database takes a transaction.

        One that fails by itself, or finds the queue full, is logged and counted.
        """
        try:
            self._enqueue(statement, keep=True).add_done_callback(self._count_failure)
        except DatabaseUnavailableError as error:
            self.failed_submissions += 1
            _log.error("a submitted write was refused: %s", error)

    async def flush(self) -> None:
        """Wait until everything submitted so far is stored."""
        await asyncio.wrap_future(self._enqueue(_nothing, keep=True))

    async def read(self, statement: Statement[T]) -> T:
        """Run ``statement(connection)`` on a read-only connection in another thread.

        Raises
        ------
        DatabaseUnavailableError
            If the database does not answer.
        """
        with _outages():
            return await asyncio.wrap_future(self._readers.submit(self.read_now, statement))

    def read_now(self, statement: Statement[T]) -> T:
        """Run ``statement(connection)`` on a read-only connection here."""
        with self._reading.connect() as connection:
            return statement(connection)

    async def close(self) -> None:
        """Store what waits, then end the threads and connections."""
        await asyncio.to_thread(self.close_now)

    def close_now(self) -> None:
        """Do the same as `close` for callers without an event loop."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._writer.join()
        self._readers.shutdown()
        self._reading.dispose()
        self._writing.dispose()

    def _enqueue(self, statement: Statement[T], *, keep: bool) -> Future[T]:
        future: Future[T] = Future()
        with self._wake:
            if self._closing:
                msg = "the database is closed"
                raise DatabaseUnavailableError(msg)
            if len(self._queue) >= self._queue_limit:
                msg = f"{self._queue_limit} writes wait already"
                raise DatabaseUnavailableError(msg)
            self._queue.append(_Write(statement, future, keep))
            self._wake.notify()
        return future

    def _count_failure(self, future: Future[None]) -> None:
        error = future.exception()
        if error is not None:
            self.failed_submissions += 1
            _log.error("a submitted write failed", exc_info=error)

    def _run(self) -> None:
        while group := self._next_group():
            # From here on a waiting caller can no longer cancel.
            started = [
                w for w in group if w.done.running() or w.done.set_running_or_notify_cancel()
            ]
            refused = self._commit(started)
            if refused is not None:
                self._put_back(started, refused)

    def _next_group(self) -> list[_Write]:
        """Wait for writes and take them; the empty group says that the database closes."""
        with self._wake:
            while not self._queue and not self._closing:
                self._wake.wait()
            size = min(len(self._queue), self._group_limit)
            return [self._queue.popleft() for _ in range(size)]

    def _commit(self, group: list[_Write]) -> Exception | None:
        """Run a group in one transaction and answer its callers; return why it was refused."""
        try:
            with self._writing.begin() as connection:
                outcomes = [_run_alone(connection, write.run) for write in group]
        except Exception as error:  # noqa: BLE001 - the one writer must outlive every refusal
            return error
        for write, (value, failure) in zip(group, outcomes, strict=True):
            if failure is None:
                write.done.set_result(value)
            else:
                write.done.set_exception(failure)
        return None

    def _put_back(self, group: list[_Write], refused: Exception) -> None:
        """After a refused transaction: keep what was submitted, tell the others, wait a little."""
        _log.warning("the database refused a transaction of %d writes: %s", len(group), refused)
        with self._wake:
            kept = [write for write in group if write.keep and not self._closing]
            self._queue.extendleft(reversed(kept))
        for write in group:
            if write not in kept:
                error = DatabaseUnavailableError(str(refused))
                error.__cause__ = refused
                write.done.set_exception(error)
        with self._wake:
            self._wake.wait_for(lambda: self._closing, RETRY_AFTER_S)


@contextmanager
def _outages() -> Iterator[None]:
    """Turn what drivers raise when a database is out of order into our one error for it."""
    try:
        yield
    except (OperationalError, InterfaceError, PoolTimeoutError) as error:
        raise DatabaseUnavailableError(str(error)) from error


def _run_alone(connection: Connection, statement: Statement[Any]) -> tuple[Any, Exception | None]:
    """Run in a savepoint, so that a failure undoes and fails this one statement only."""
    savepoint = connection.begin_nested()
    try:
        value = statement(connection)
    except Exception as error:  # noqa: BLE001 - handed to the caller, whatever it is
        savepoint.rollback()
        return None, error
    savepoint.commit()
    return value, None


def _nothing(_connection: Connection) -> None:
    """Write nothing; waiting for it waits for all before it."""
