"""SQLAlchemy engines: how connections to SQLite and PostgreSQL are opened."""

import sqlite3
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url

# A second process (the command line beside a running server) waits this long for SQLite's one
# write lock; a group commit holds it for milliseconds.
BUSY_TIMEOUT_MS = 5_000

# Each attempt at the journal mode ends behind somebody else's lock; a handful of processes may
# start on a new file together.
WAL_ATTEMPTS = 8


def writing_engine(url: str) -> Engine:
    """Return an engine with the one connection of the writer."""
    return _engine(url, connections=1, reading=False)


def migrating_engine(url: str) -> Engine:
    """Return an engine for changes of the schema: like the writer's, but blind to foreign keys.

    SQLite changes a table by replacing it; with foreign keys on, dropping the old one would delete
    the rows that refer to it. PostgreSQL alters in place and needs no such thing.
    """
    return _engine(url, connections=1, reading=False, foreign_keys=False)


def reading_engine(url: str, readers: int) -> Engine:
    """Return an engine whose connections refuse to write."""
    return _engine(url, connections=readers, reading=True)


def sqlite_file(url: str) -> Path | None:
    """Return the file of a SQLite database; None for another database, or one in memory."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or parsed.database in {None, "", ":memory:"}:
        return None
    return Path(str(parsed.database))


def _engine(url: str, *, connections: int, reading: bool, foreign_keys: bool = True) -> Engine:
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite":
        return _sqlite(parsed, connections, reading=reading, foreign_keys=foreign_keys)
    if parsed.get_backend_name() == "postgresql":
        return _postgresql(parsed, connections, reading=reading)
    msg = f"neither a sqlite nor a postgresql URL: {parsed.render_as_string()}"
    raise ValueError(msg)


def _postgresql(url: URL, connections: int, *, reading: bool) -> Engine:
    return create_engine(
        url.set(drivername="postgresql+psycopg"),
        pool_size=connections,
        max_overflow=4 if reading else 0,
        # After a restart of the server a stale connection is replaced, not handed to a caller.
        pool_pre_ping=True,
        execution_options={"postgresql_readonly": reading},
    )


def _keep_write_ahead_log(connection: sqlite3.Connection) -> None:
    """Set the journal mode, which a new file does not have yet.

    SQLite does not wait for others in this one statement, whatever the busy timeout says. So after
    a refusal the write lock is waited for, which the timeout does rule, and then it is tried again.
    """
    for _ in range(WAL_ATTEMPTS - 1):
        try:
            connection.execute("PRAGMA journal_mode = WAL")
        except sqlite3.OperationalError:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("COMMIT")
        else:
            return
    connection.execute("PRAGMA journal_mode = WAL")


def _sqlite(url: URL, connections: int, *, reading: bool, foreign_keys: bool) -> Engine:
    if not url.database or url.database == ":memory:":
        msg = "SQLite needs a file: every connection to memory would be a database of its own"
        raise ValueError(msg)
    engine = create_engine(
        url, pool_size=connections, max_overflow=4 if reading else 0, pool_timeout=60
    )

    @event.listens_for(engine, "connect")
    def set_up(connection: sqlite3.Connection, _record: object) -> None:
        # Python's driver would open transactions by itself, without savepoints; we say BEGIN.
        connection.isolation_level = None
        connection.execute(f"PRAGMA busy_timeout = {BUSY_TIMEOUT_MS}")
        _keep_write_ahead_log(connection)
        connection.execute(f"PRAGMA foreign_keys = {int(foreign_keys)}")
        # FULL syncs the write-ahead log at every commit: what was acknowledged to a phone, which
        # then forgets it, survives a power cut. NORMAL would survive only the end of the process.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute(f"PRAGMA query_only = {int(reading)}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # IMMEDIATE: the writer waits for the lock here, where waiting is safe, not in the middle.
        connection.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")

    return engine
