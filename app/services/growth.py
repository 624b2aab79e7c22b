"""Growth of radio maps from use: sessions are kept aside, looked at, and accepted or discarded.

Nothing that is kept aside is matched with. The map that an admin accepts is a new version; the one
before stays as it is, to go back to.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

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
from app.services.job_lane import JobLane
from app.services.jobs import JobBoard
from app.services.site import SiteDirectory
from app.services.writing import write
from app.storage import quarantine, radio_maps
from app.storage.database import Database
from app.storage.jobs import StoredJob
from app.storage.log import SqlObservationLog, logged_bytes
from app.storage.quarantine import KeptAside
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap
from app.storage.sites import get_site

MAX_SESSION_BYTES = 32 << 20
"""Longer sessions are not taken: some ten hours of scans, seconds of one core in every round."""

MAX_SESSIONS = 300
"""Looked at together, the newest first: about a minute of one core."""

KIND = "map growth"

CELL_M = 5.0
"""Edge of the cells in which growth is told: tracks are known to some metres."""

SESSIONS_AT_ONCE = 5
"""Taken aside in one round of housekeeping: the next one comes soon."""

# Whatever profile a session had: published ones have no smoother.
_PARAMS = PROFILES["best"].params


@dataclass(frozen=True, slots=True)
class GrownPlace:
    """A cell of the map, by its centre, and how many fingerprints it would gain."""

    floor_id: str
    x_m: float
    y_m: float
    fingerprints: int


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What the sessions kept aside would make of the map, as it was at one time.

    Attributes
    ----------
    version
        The site's ``model_version`` that it was taken of.
    asked
        The sessions looked at, those that are too strange to the map yet too: ids, and when each
        was taken aside.
    joining
        Those that would join.
    radio_map
        The map grown by them; None where none would join.
    effect, places
        What they would change, and where.
    """

    site_id: str
    version: int
    looked_s: float
    asked: tuple[tuple[str, float], ...]
    joining: tuple[GrownSession, ...] = ()
    radio_map: RadioMap | None = None
    effect: GrowthEffect | None = None
    places: tuple[GrownPlace, ...] = ()

    @property
    def fingerprints(self) -> int:
        """Return how many fingerprints the map would gain."""
        return sum(len(session.candidates) for session in self.joining)

    def document(self) -> dict[str, Any]:
        """Return what an admin is told of it, as JSON."""
        return {
            "sessions": len(self.joining),
            "fingerprints": self.fingerprints,
            "places": [
                {"floor_id": p.floor_id, "x": p.x_m, "y": p.y_m, "fingerprints": p.fingerprints}
                for p in self.places
            ],
            "effect": None if self.effect is None else asdict(self.effect),
        }


class GrowthService:
    """Looks at what is kept aside, as jobs, and accepts or discards it.

    The newest look at each site is remembered: it is what an admin accepts.
    """

    def __init__(self, database: Database, directory: SiteDirectory, board: JobBoard) -> None:
        self._database = database
        self._directory = directory
        self._board = board
        self._lane = JobLane(board, KIND)
        self._latest: dict[str, Look] = {}

    async def start(self, site_id: str) -> StoredJob:
        """Begin a look at a site and return its job; its result is what would change.

        Raises
        ------
        AppError
            If there is no such site.
        """
        found(self._directory.current(site_id), "site", site_id)
        return await self._lane.start(site_id, self._look)

    async def settle(self) -> None:
        """Wait until all looks asked for by now have ended."""
        await self._lane.settle()

    async def close(self) -> None:
        """Give up what has not ended."""
        await self._lane.close()

    async def waiting(self, site_id: str) -> int:
        """Return how many sessions of a site are kept aside, undecided."""
        found(self._directory.current(site_id), "site", site_id)
        return await self._database.read(partial(quarantine.count_quarantined, site_id=site_id))

    def latest(self, site_id: str) -> Look | None:
        """Return the newest look at a site; None if there is none of the site as it is now."""
        look, model = self._latest.get(site_id), self._directory.current(site_id)
        return look if look and model and look.version == model.version else None

    async def accept(self, site_id: str, now_s: float, *, activate: bool) -> StoredRadioMap:
        """Store the map of the newest look as the site's next version, the active one if asked.

        Sessions that are too strange to the map yet stay aside: with the grown one they may join.

        Raises
        ------
        AppError
            If nobody has looked, nothing would join, or something was changed since the look.
        """
        found(self._directory.current(site_id), "site", site_id)
        look = self.latest(site_id)
        if look is None:
            detail = "nobody has looked at the growth of this map yet, or it was changed since"
            raise AppError(ErrorCode.CONFLICT, detail)
        stored = await accept_look(self._database, look, now_s, activate=activate)
        self._latest.pop(site_id, None)
        await self._directory.refresh()
        return stored

    async def discard(self, site_id: str, now_s: float) -> int:
        """Forget everything kept aside at a site; return how many sessions that were."""
        found(self._directory.current(site_id), "site", site_id)
        self._latest.pop(site_id, None)
        return await discard_all(self._database, site_id, now_s)

    async def _look(self, job: StoredJob) -> None:
        running = replace(job, state="running", progress={"sessions": 0})
        model = found(self._directory.current(job.site_id), "site", job.site_id)
        aside = await sessions_aside(self._database, job.site_id)
        running = replace(running, progress={"sessions": len(aside)})
        await self._board.update(running)
        look = self.latest(job.site_id)
        if look is None or look.asked != _asked(aside):
            look = await asyncio.to_thread(taken_look, model, aside, self._board.now_s)
            self._latest[job.site_id] = look
        await self._board.end(running.done(look.document(), self._board.now_s))


async def sessions_aside(database: Database, site_id: str) -> list[KeptAside]:
    """Return the newest sessions kept aside at a site, as many as are looked at together."""
    return await database.read(partial(quarantine.quarantined, site_id=site_id, limit=MAX_SESSIONS))


def taken_look(model: SiteModel, aside: Sequence[KeptAside], now_s: float) -> Look:
    """Let a site's map grow by sessions, and tell what that changes; takes up to a minute."""
    nothing = Look(model.site_id, model.version, now_s, _asked(aside))
    if model.radio_map is None or not aside:
        return nothing
    joining = grow([one.session for one in aside], model, _PARAMS, GrowingParams())
    if not joining:
        return nothing
    radio_map = grown_map(model.radio_map, joining, model)
    return replace(
        nothing,
        joining=joining,
        radio_map=radio_map,
        effect=growth_effect(model.radio_map, radio_map, _PARAMS.match),
        places=_places(joining, model),
    )


async def accept_look(
    database: Database, look: Look, now_s: float, *, activate: bool
) -> StoredRadioMap:
    """Store the map of a look as the site's next version.

    Raises
    ------
    AppError
        If nothing would join, or the site or a session that was looked at was changed since.
    """
    grown = look.radio_map
    if grown is None:
        raise AppError(ErrorCode.CONFLICT, "no session kept aside would join the radio map")
    ids = [session.session_id for session in look.joining]

    def statement(connection: Connection) -> StoredRadioMap:
        site = found(get_site(connection, look.site_id), "site", look.site_id)
        # All that were looked at, not those that join alone: each had a part in what was shown.
        changed = set(look.asked) - quarantine.undecided(connection, look.site_id)
        if site.model_version != look.version or changed:
            detail = "the site or what is kept aside was changed meanwhile; look again"
            raise AppError(ErrorCode.CONFLICT, detail)
        origin = _origin(connection, look, now_s)
        quarantine.decide(connection, ids, now_s)
        return radio_maps.save_radio_map(connection, look.site_id, grown, origin, activate=activate)

    return await write(database, statement)


async def discard_all(database: Database, site_id: str, now_s: float) -> int:
    """Decide against everything kept aside at a site; return how many sessions that were."""
    return await write(database, partial(quarantine.discard, site_id=site_id, decided_s=now_s))


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


def _asked(aside: Sequence[KeptAside]) -> tuple[tuple[str, float], ...]:
    return tuple((one.session.session_id, one.collected_s) for one in aside)


def _places(joining: Sequence[GrownSession], model: SiteModel) -> tuple[GrownPlace, ...]:
    rows = [c.fingerprint for session in joining for c in session.candidates]
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


def _origin(connection: Connection, look: Look, now_s: float) -> RadioMapOrigin:
    active = radio_maps.list_radio_maps(connection, site_id=look.site_id, active=True, limit=1)
    provenance = {
        "grown_from": active[0].radio_map_id if active else None,
        "sessions": len(look.joining),
        "grown_fingerprints": look.fingerprints,
    }
    return RadioMapOrigin("grown from use", now_s, provenance)
