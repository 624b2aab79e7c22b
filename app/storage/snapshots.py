"""Snapshots: the last checkpoint of every running session."""

import logging

from sqlalchemy import select

from app.core.engine import SessionState
from app.storage.codec import SchemaError, TreeCodec
from app.storage.database import Database
from app.storage.tables import SNAPSHOTS
from app.storage.upsert import upsert

_log = logging.getLogger(__name__)


class SqlSnapshotStore:
    """Snapshots in the database, written through the same queue as track points.

    So whatever was written to the track before a snapshot is stored before it.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._codec = TreeCodec(SessionState)

    async def save(self, session_id: str, profile: str, state: SessionState) -> None:
        """Replace the session's snapshot by one that was folded with this profile."""
        payload = self._codec.encode(state)
        row = {"session_id": session_id, "profile": profile, "payload": payload}
        await self._database.write(lambda connection: upsert(connection, SNAPSHOTS, [row]))

    async def load(self, session_id: str, profile: str) -> SessionState | None:
        """Return the session's snapshot.

        None if there is none of this profile, or another build wrote it.

        Without a snapshot the session is folded again from its log.
        """
        query = select(SNAPSHOTS.c.payload).where(
            SNAPSHOTS.c.session_id == session_id, SNAPSHOTS.c.profile == profile
        )
        blob = await self._database.read(lambda connection: connection.scalar(query))
        if blob is None:
            return None
        try:
            return self._codec.decode(blob)
        except SchemaError as error:
            _log.info("snapshot of session %s not used: %s", session_id, error)
            return None
