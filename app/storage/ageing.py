"""Transmitters that traffic contradicts, by radio map, and which are left out of matching."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, delete, insert, select, update

from app.core.fingerprint.ageing import Change, Suspect
from app.core.session import event_times
from app.core.types import BleScan, Observation, WifiScan
from app.storage.log_rows import CLOCK, LOGGED, logged_batch, session_clock
from app.storage.sites import touch_model
from app.storage.tables import AGED_TRANSMITTERS, OBSERVATION_BATCHES, RADIO_MAPS, SESSIONS

MAX_BATCHES = 20_000
"""Batches of traffic looked at, the newest: what a site of a hundred phones posts in an hour."""


@dataclass(frozen=True, slots=True)
class AgedTransmitter:
    """A suspect as stored: when it was last found, and whether it is left out of matching."""

    suspect: Suspect
    found_s: float
    quarantined: bool


def replace_suspects(
    connection: Connection, radio_map_id: str, suspects: Sequence[Suspect], found_s: float
) -> None:
    """Store what a look at traffic found; what is quarantined stays so, found again or not."""
    held = quarantined_keys(connection, radio_map_id)
    of_map = AGED_TRANSMITTERS.c.radio_map_id == radio_map_id
    found = {suspect.key for suspect in suspects}
    connection.execute(
        delete(AGED_TRANSMITTERS).where(
            of_map, AGED_TRANSMITTERS.c.key.in_(found) | ~AGED_TRANSMITTERS.c.quarantined
        )
    )
    rows = [
        {
            "radio_map_id": radio_map_id,
            "key": suspect.key,
            "change": suspect.change.value,
            "excess": suspect.excess,
            "scans": suspect.scans,
            "misplaced": suspect.misplaced,
            "expected": suspect.expected,
            "found_s": found_s,
            "quarantined": suspect.key in held,
        }
        for suspect in suspects
    ]
    if rows:
        connection.execute(insert(AGED_TRANSMITTERS), rows)


def list_aged(connection: Connection, radio_map_id: str) -> list[AgedTransmitter]:
    """Return the suspects of a radio map, the worst first."""
    query = select(AGED_TRANSMITTERS).where(AGED_TRANSMITTERS.c.radio_map_id == radio_map_id)
    aged = [
        AgedTransmitter(
            Suspect(
                key=row["key"],
                change=Change(row["change"]),
                excess=row["excess"],
                scans=row["scans"],
                misplaced=row["misplaced"],
                expected=row["expected"],
            ),
            found_s=row["found_s"],
            quarantined=row["quarantined"],
        )
        for row in connection.execute(query).mappings()
    ]
    return sorted(aged, key=lambda a: (-a.suspect.excess, -a.suspect.scans, a.suspect.key))


def quarantined_keys(connection: Connection, radio_map_id: str) -> frozenset[str]:
    """Return the transmitters that are left out of matching with a radio map."""
    query = select(AGED_TRANSMITTERS.c.key).where(
        AGED_TRANSMITTERS.c.radio_map_id == radio_map_id, AGED_TRANSMITTERS.c.quarantined
    )
    return frozenset(connection.execute(query).scalars())


def quarantined_of_active(connection: Connection, site_id: str) -> frozenset[str]:
    """Return the transmitters left out of matching at a site."""
    query = (
        select(AGED_TRANSMITTERS.c.key)
        .join(RADIO_MAPS, RADIO_MAPS.c.id == AGED_TRANSMITTERS.c.radio_map_id)
        .where(RADIO_MAPS.c.site_id == site_id, RADIO_MAPS.c.active)
        .where(AGED_TRANSMITTERS.c.quarantined)
    )
    return frozenset(connection.execute(query).scalars())


def set_quarantine(
    connection: Connection, radio_map_id: str, keys: Sequence[str], *, quarantined: bool
) -> None:
    """Leave listed transmitters out of matching with a radio map, or take them in again."""
    connection.execute(
        update(AGED_TRANSMITTERS)
        .where(AGED_TRANSMITTERS.c.radio_map_id == radio_map_id)
        .where(AGED_TRANSMITTERS.c.key.in_(keys))
        .values(quarantined=quarantined)
    )
    site_id = connection.execute(
        select(RADIO_MAPS.c.site_id).where(RADIO_MAPS.c.id == radio_map_id)
    ).scalar_one()
    touch_model(connection, site_id)


def traffic(connection: Connection, site_id: str, since_s: float) -> list[list[Observation]]:
    """Return the scans posted at a site since a time, by session, in event time and in order."""
    batches = OBSERVATION_BATCHES.c
    query = (
        select(*(batches[name] for name in LOGGED), *(SESSIONS.c[name] for name in CLOCK))
        .join(SESSIONS, SESSIONS.c.id == batches.session_id)
        .where(SESSIONS.c.site_id == site_id, batches.received_s >= since_s)
        .order_by(batches.received_s.desc())
        .limit(MAX_BATCHES)
    )
    sessions: dict[str, list[Observation]] = {}
    for row in connection.execute(query):
        timed = event_times([logged_batch(row)], session_clock(row))
        scans = [o for o in timed if isinstance(o, WifiScan | BleScan)]
        sessions.setdefault(row.session_id, []).extend(scans)
    return [sorted(session, key=lambda o: o.time_s) for session in sessions.values()]
