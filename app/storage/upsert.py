"""Inserts that meet a row with the same key, in the words of either database."""

from collections.abc import Mapping, Sequence

from sqlalchemy import Column, Connection, Table
from sqlalchemy.dialects import postgresql, sqlite

Values = Mapping[str, object]


def insert_new(connection: Connection, table: Table, values: Values, *key: Column[object]) -> bool:
    """Insert a row unless one with its ``key`` is there; tell whether it was inserted."""
    statement = _insert(connection, table).values(values).on_conflict_do_nothing(index_elements=key)
    return connection.execute(statement.returning(*table.primary_key)).first() is not None


def upsert(connection: Connection, table: Table, rows: Sequence[Values]) -> None:
    """Insert rows; of a primary key that is there, replace every other column."""
    insert = _insert(connection, table)
    replaced = {c.name: insert.excluded[c.name] for c in table.c if not c.primary_key}
    statement = insert.on_conflict_do_update(index_elements=list(table.primary_key), set_=replaced)
    connection.execute(statement, rows)


def _insert(connection: Connection, table: Table) -> sqlite.Insert | postgresql.Insert:
    if connection.dialect.name == "sqlite":
        return sqlite.insert(table)
    return postgresql.insert(table)
