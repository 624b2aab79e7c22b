"""Does the database answer? For readiness checks."""

import asyncio

from sqlalchemy import Connection, text

from app.storage.database import Database, DatabaseUnavailableError


async def answers_reads(database: Database, patience_s: float) -> bool:
    """Tell whether a read came back in time."""
    try:
        async with asyncio.timeout(patience_s):
            await database.read(_ask)
    except (DatabaseUnavailableError, TimeoutError):
        return False
    return True


async def answers_writes(database: Database, patience_s: float) -> bool:
    """Tell whether the writer lives and could commit in time."""
    try:
        await database.write(_ask, patience_s)
    except DatabaseUnavailableError:
        return False
    return True


def _ask(connection: Connection) -> None:
    connection.execute(text("SELECT 1"))
