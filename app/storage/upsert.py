"""Inserts that meet a row with the same key, in the words of either database."""

from collections.abc import Mapping, Sequence
from functools import cache

from sqlalchemy import Column, Connection, Executable, Table
from sqlalchemy.dialects import postgresql, sqlite

Values = Mapping[str, object]


def insert_new(connection: Connection, table: Table, values: Values, *key: Column[object]) -> bool:
    """Insert a row unless one with its ``key`` is there; tell whether it was inserted."""
    statement = _insert_new(connection.dialect.name, table, key)
    return connection.execute(statement, values).first() is not None


def upsert(connection: Connection, table: Table, rows: Sequence[Values]) -> None:
    """Insert rows; of a primary key that is there, replace every other column."""
    connection.execute(_upsert(connection.dialect.name, table), rows)


# Statements are built once: building one takes several times as long as running it.
@cache
def _insert_new(dialect: str, table: Table, key: tuple[Column[object], ...]) -> Executable:
    insert = insert_into(dialect, table).on_conflict_do_nothing(index_elements=key)
    return insert.returning(*table.primary_key)


@cache
def _upsert(dialect: str, table: Table) -> Executable:
    insert = insert_into(dialect, table)
    replaced = {c.name: insert.excluded[c.name] for c in table.c if not c.primary_key}
    return insert.on_conflict_do_update(index_elements=list(table.primary_key), set_=replaced)


def insert_into(dialect: str, table: Table) -> sqlite.Insert | postgresql.Insert:
    """Return an insert that may say what a row with the same key becomes."""
    return sqlite.insert(table) if dialect == "sqlite" else postgresql.insert(table)
