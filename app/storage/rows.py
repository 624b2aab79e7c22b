"""What the repositories share: broken unique keys as errors of ours, and checked row versions."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection, Table, update
from sqlalchemy.exc import IntegrityError

_UNIQUE = frozenset({"23505", "SQLITE_CONSTRAINT_UNIQUE", "SQLITE_CONSTRAINT_PRIMARYKEY"})


class DuplicateError(Exception):
    """A row with the same id, or another unique name, is there already."""


class StaleError(Exception):
    """The row was changed or removed since it was read."""


@contextmanager
def unique(what: str) -> Iterator[None]:
    """Turn the violation of a unique key into `DuplicateError`; ``what`` names the row in words."""
    try:
        yield
    except IntegrityError as error:
        code = getattr(error.orig, "sqlstate", None) or getattr(error.orig, "sqlite_errorname", "")
        if code in _UNIQUE:
            msg = f"{what} is there already"
            raise DuplicateError(msg) from error
        raise


def update_row(
    connection: Connection, table: Table, row_id: str, row_version: int, values: Mapping[str, Any]
) -> int:
    """Change the row that was read as ``row_version`` and return its new version.

    Raises
    ------
    StaleError
        If the stored row is not of that version any more.
    """
    changed = connection.execute(
        update(table)
        .where(table.c.id == row_id, table.c.row_version == row_version)
        .values(**values, row_version=row_version + 1)
    )
    if changed.rowcount != 1:
        msg = f"{table.name} {row_id!r} was changed meanwhile"
        raise StaleError(msg)
    return row_version + 1
