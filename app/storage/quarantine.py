"""Finished sessions kept aside: nothing is matched with them before an admin accepts them."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, func, insert, select, update

from app.core.engine.growing import FinishedSession
from app.core.session import SessionRecord
from app.storage.log_rows import OBSERVATIONS, session_record
from app.storage.tables import QUARANTINED_SESSIONS, SESSIONS


@dataclass(frozen=True, slots=True)
class KeptAside:
    """A session kept aside, and when it was taken: one that went on is taken again, with more."""

    session: FinishedSession
    collected_s: float


def not_yet_collected(connection: Connection, site_id: str, limit: int) -> list[SessionRecord]:
    """Return finished sessions of a site that nobody has looked at, newest first."""
    query = (
        select(SESSIONS)
        .outerjoin(QUARANTINED_SESSIONS, QUARANTINED_SESSIONS.c.session_id == SESSIONS.c.id)
        .where(SESSIONS.c.site_id == site_id, SESSIONS.c.finished)
        .where(QUARANTINED_SESSIONS.c.session_id.is_(None))
        .order_by(SESSIONS.c.opened_s.desc(), SESSIONS.c.id)
        .limit(limit)
    )
    return [session_record(row) for row in connection.execute(query)]


def quarantine(
    connection: Connection, site_id: str, session: FinishedSession, collected_s: float
) -> None:
    """Keep a session aside; one that was opened again meanwhile is not: it is not over.

    One without observations is decided already: there is nothing to learn from it.
    """
    over = select(SESSIONS.c.id).where(SESSIONS.c.id == session.session_id, SESSIONS.c.finished)
    if connection.execute(over).first() is None:
        return
    connection.execute(
        insert(QUARANTINED_SESSIONS).values(
            session_id=session.session_id,
            site_id=site_id,
            collected_s=collected_s,
            decided_s=None if session.observations else collected_s,
            payload=OBSERVATIONS.encode(session.observations),
        )
    )


def quarantined(connection: Connection, site_id: str, limit: int) -> list[KeptAside]:
    """Return the newest sessions kept aside at a site, undecided, at most ``limit``, by id."""
    kept = QUARANTINED_SESSIONS.c
    query = (
        select(kept.session_id, kept.payload, kept.collected_s)
        .where(kept.site_id == site_id, kept.decided_s.is_(None))
        .order_by(kept.collected_s.desc(), kept.session_id)
        .limit(limit)
    )
    aside = [
        KeptAside(
            FinishedSession(row.session_id, OBSERVATIONS.decode(row.payload)), row.collected_s
        )
        for row in connection.execute(query)
    ]
    return sorted(aside, key=lambda one: one.session.session_id)


def undecided(connection: Connection, site_id: str) -> set[tuple[str, float]]:
    """Return the sessions kept aside at a site, undecided: ids, and when each was taken."""
    kept = QUARANTINED_SESSIONS.c
    query = select(kept.session_id, kept.collected_s).where(
        kept.site_id == site_id, kept.decided_s.is_(None)
    )
    return {(row.session_id, row.collected_s) for row in connection.execute(query)}


def count_quarantined(connection: Connection, site_id: str) -> int:
    """Return how many sessions of a site are kept aside, undecided."""
    kept = QUARANTINED_SESSIONS.c
    query = select(func.count()).where(kept.site_id == site_id, kept.decided_s.is_(None))
    return connection.execute(query).scalar() or 0


def decide(connection: Connection, session_ids: Sequence[str], decided_s: float) -> None:
    """Forget what sessions kept aside told; they are not taken again."""
    for session_id in session_ids:
        connection.execute(
            update(QUARANTINED_SESSIONS)
            .where(QUARANTINED_SESSIONS.c.session_id == session_id)
            .values(decided_s=decided_s, payload=OBSERVATIONS.encode([]))
        )


def discard(connection: Connection, site_id: str, decided_s: float) -> int:
    """Decide against everything kept aside at a site; return how many sessions that were."""
    kept = QUARANTINED_SESSIONS.c
    undecided = update(QUARANTINED_SESSIONS).where(
        kept.site_id == site_id, kept.decided_s.is_(None)
    )
    values = {"decided_s": decided_s, "payload": OBSERVATIONS.encode([])}
    return connection.execute(undecided.values(values)).rowcount


def expire(connection: Connection, site_id: str, before_s: float, decided_s: float) -> int:
    """Forget what sessions kept aside told that were opened before a time; return how many."""
    kept = QUARANTINED_SESSIONS.c
    old = select(SESSIONS.c.id).where(SESSIONS.c.site_id == site_id, SESSIONS.c.opened_s < before_s)
    expired = (
        update(QUARANTINED_SESSIONS)
        .where(kept.site_id == site_id, kept.decided_s.is_(None), kept.session_id.in_(old))
        .values(decided_s=decided_s, payload=OBSERVATIONS.encode([]))
    )
    return connection.execute(expired).rowcount
