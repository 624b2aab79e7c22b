"""Edits of the registry: one transaction each, refused in words the sender can act on."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

from sqlalchemy import Connection

from app.services.errors import AppError, ErrorCode
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.rows import DuplicateError, StaleError

T = TypeVar("T")

SeenVersions: TypeAlias = frozenset[str] | None
"""Row versions that an edit may have been made on; None: whatever is stored."""


async def write(database: Database, statement: Callable[[Connection], T]) -> T:
    """Run one transaction; its expected failures become `AppError`."""
    try:
        return await database.write(statement, database.edit_wait_s)
    except DuplicateError as error:
        raise AppError(ErrorCode.CONFLICT, str(error)) from error
    except StaleError as error:
        raise AppError(ErrorCode.ETAG_MISMATCH, str(error)) from error
    except DatabaseUnavailableError as error:
        detail = "the database does not take writes now"
        raise AppError(ErrorCode.UNAVAILABLE, detail, retry_after_s=2) from error


def check_seen(seen: SeenVersions, row_version: int | str, what: str = "it") -> None:
    """Refuse an edit of ``what`` that was made on another state than the stored one."""
    if seen is not None and str(row_version) not in seen:
        detail = f"{what} was changed meanwhile; read it again"
        raise AppError(ErrorCode.ETAG_MISMATCH, detail)
