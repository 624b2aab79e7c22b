"""Growth of radio maps from use: sessions are kept aside, looked at, and accepted or discarded.

Nothing that is kept aside is matched with. The map that an admin accepts is a new version; the one
before stays as it is, to go back to.
"""

import asyncio
from dataclasses import dataclass
from functools import partial

import numpy as np
from sqlalchemy import Connection

from app.core.engine import PROFILES
from app.core.engine.growing import (
    FinishedSession,
    GrowingParams,
    GrownSession,
    condensed,
    grow,
    grown_map,
)
from app.core.fingerprint.cells import cells_of
from app.core.fingerprint.growth_effect import GrowthEffect, growth_effect
from app.core.fingerprint.radio_map import RadioMap
from app.core.session import SessionRecord
from app.core.site import SiteModel
from app.core.types import Observation, WifiScan
from app.services.errors import AppError, ErrorCode, found
from app.services.site import SiteDirectory
from app.services.writing import write
from app.storage import quarantine, radio_maps
from app.storage.database import Database
from app.storage.log import SqlObservationLog, logged_bytes
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap
from app.storage.sites import get_site

MAX_SESSION_BYTES = 32 << 20
"""Longer sessions are not taken: some ten hours of scans, seconds of one core in every round."""

MAX_SESSIONS = 300
"""Looked at together, the newest first: about a minute of one core."""

CELL_M = 5.0
"""Edge of the cells in which growth is told: tracks are known to some metres."""

SESSIONS_AT_ONCE = 5
"""Taken aside in one round of housekeeping: the next one comes soon."""

# What is asked for now is mostly there by then.
_RETRY_AFTER_S = 10

# Whatever profile a session had: published ones have no smoother.
_PARAMS = PROFILES["best"].params


@dataclass(frozen=True, slots=True)
class GrownPlace:
    """A cell of the map, by its centre, and how many fingerprints it would gain."""

    floor_id: str
    x_m: float
    y_m: float
    fingerprints: int


@dataclass(frozen=True, slots=True)
class Growth:
    """What the sessions kept aside would make of the map.

    Attributes
    ----------
    waiting
        Sessions kept aside, those that are too strange to the map yet too.
    sessions, fingerprints, places
        Those that would join, their fingerprints, and where.
    effect
        What they would change; None where none would join.
    """

    waiting: int
    sessions: int
    fingerprints: int
    places: tuple[GrownPlace, ...]
    effect: GrowthEffect | None


@dataclass(frozen=True, slots=True, eq=False)
class _Outcome:
    """A map that grew, of the site's ``model_version`` and these sessions kept aside."""

    key: tuple[int, tuple[str, ...]]
    sessions: tuple[GrownSession, ...]
    radio_map: RadioMap | None
    effect: GrowthEffect | None


class GrowthService:
    """Looks at what is kept aside, one site at a time: what phones post now comes first."""

    def __init__(self, database: Database, directory: SiteDirectory) -> None:
        self._database = database
        self._directory = directory
        self._turn = asyncio.Lock()
        self._latest: dict[str, _Outcome] = {}

    async def look(self, site_id: str) -> Growth:
        """Return what would change if an admin accepted.

        Raises
        ------
        AppError
            If there is no such site, or another look is being taken.
        """
        outcome = await self._outcome(site_id)
        waiting = await self._database.read(partial(quarantine.count_quarantined, site_id=site_id))
        rows = [c.fingerprint for session in outcome.sessions for c in session.candidates]
        model = found(self._directory.current(site_id), "site", site_id)
        return Growth(
            waiting, len(outcome.sessions), len(rows), _places(outcome, model), outcome.effect
        )

    async def accept(self, site_id: str, now_s: float, *, activate: bool) -> StoredRadioMap:
        """Store the grown map as the site's next version, the active one if asked.

        Sessions that are too strange to the map yet stay aside: with the grown one they may join.

        Raises
        ------
        AppError
            If nothing would join, or the site was changed meanwhile.
        """
        outcome = await self._outcome(site_id)
        grown = outcome.radio_map
        if grown is None or not outcome.sessions:
            raise AppError(ErrorCode.CONFLICT, "no session kept aside would join the radio map")

        def statement(connection: Connection) -> StoredRadioMap:
            site = found(get_site(connection, site_id), "site", site_id)
            if site.model_version != outcome.key[0]:
                detail = "the site was changed meanwhile; look at its growth again"
                raise AppError(ErrorCode.CONFLICT, detail)
            origin = _origin(connection, site_id, outcome, now_s)
            quarantine.decide(connection, [s.session_id for s in outcome.sessions], now_s)
            return radio_maps.save_radio_map(connection, site_id, grown, origin, activate=activate)

        stored = await write(self._database, statement)
        self._latest.pop(site_id, None)
        await self._directory.refresh()
        return stored

    async def discard(self, site_id: str, now_s: float) -> int:
        """Forget everything kept aside at a site; return how many sessions that were."""
        found(self._directory.current(site_id), "site", site_id)
        self._latest.pop(site_id, None)
        return await write(
            self._database, partial(quarantine.discard, site_id=site_id, decided_s=now_s)
        )

    async def _outcome(self, site_id: str) -> _Outcome:
        if self._turn.locked():
            detail = "another look at the growth of a map is being taken"
            raise AppError(ErrorCode.TOO_MANY_REQUESTS, detail, retry_after_s=_RETRY_AFTER_S)
        async with self._turn:
            model = found(self._directory.current(site_id), "site", site_id)
            sessions = await self._database.read(
                partial(quarantine.quarantined, site_id=site_id, limit=MAX_SESSIONS)
            )
            key = model.version, tuple(session.session_id for session in sessions)
            latest = self._latest.get(site_id)
            if latest is None or latest.key != key:
                latest = await asyncio.to_thread(_grown, key, sessions, model)
                self._latest[site_id] = latest
        return latest


async def take_finished_aside(
    database: Database, directory: SiteDirectory, site_id: str, now_s: float
) -> None:
    """Keep some of a site's finished sessions aside, if its map may grow and has begun to.

    Raw inertial samples are not kept, the steps that were found in them are.
    """
    model = directory.current(site_id)
    if model is None or model.radio_map is None:
        return
    fresh = await database.read(
        partial(quarantine.not_yet_collected, site_id=site_id, limit=SESSIONS_AT_ONCE)
    )
    for record in fresh:
        told = await _told(database, record)
        kept = await asyncio.to_thread(condensed, told, model, _PARAMS)
        if not any(isinstance(observation, WifiScan) for observation in kept):
            kept = ()
        session = FinishedSession(record.session_id, kept)
        await database.write(
            partial(quarantine.quarantine, site_id=site_id, session=session, collected_s=now_s)
        )


async def _told(database: Database, record: SessionRecord) -> list[Observation]:
    size = await database.read(partial(logged_bytes, session_id=record.session_id))
    if size > MAX_SESSION_BYTES:
        return []
    return await SqlObservationLog(database).observations(record.session_id)


def _grown(
    key: tuple[int, tuple[str, ...]], sessions: list[FinishedSession], model: SiteModel
) -> _Outcome:
    if model.radio_map is None or not sessions:
        return _Outcome(key, (), None, None)
    joining = grow(sessions, model, _PARAMS, GrowingParams())
    if not joining:
        return _Outcome(key, (), None, None)
    radio_map = grown_map(model.radio_map, joining, model)
    effect = growth_effect(model.radio_map, radio_map, _PARAMS.match)
    return _Outcome(key, joining, radio_map, effect)


def _places(outcome: _Outcome, model: SiteModel) -> tuple[GrownPlace, ...]:
    rows = [c.fingerprint for session in outcome.sessions for c in session.candidates]
    if not rows:
        return ()
    cells = cells_of(np.array([(row.x_m, row.y_m) for row in rows]), CELL_M)
    names = [
        (row.floor_index, int(cell[0]), int(cell[1])) for row, cell in zip(rows, cells, strict=True)
    ]
    return tuple(
        GrownPlace(
            model.floors[floor].floor_id,
            (column + 0.5) * CELL_M,
            (line + 0.5) * CELL_M,
            names.count((floor, column, line)),
        )
        for floor, column, line in sorted(set(names))
    )


def _origin(
    connection: Connection, site_id: str, outcome: _Outcome, now_s: float
) -> RadioMapOrigin:
    active = radio_maps.list_radio_maps(connection, site_id=site_id, active=True, limit=1)
    provenance = {
        "grown_from": active[0].radio_map_id if active else None,
        "sessions": len(outcome.sessions),
        "grown_fingerprints": sum(len(s.candidates) for s in outcome.sessions),
    }
    return RadioMapOrigin("grown from use", now_s, provenance)
