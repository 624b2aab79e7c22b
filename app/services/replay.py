"""Replay: a stored session run again, with another profile or radio map if asked; nothing kept."""

import asyncio
from dataclasses import dataclass, replace
from functools import partial

from sqlalchemy import Connection

from app.core.engine import smoothed
from app.core.fingerprint.radio_map import RadioMap
from app.core.session import SessionRecord
from app.core.site import SiteModel
from app.services.access import Principal
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.site import SiteDirectory, fitted_map
from app.services.site_choice import choose_params
from app.services.tracks import SitePoint, TrackKind
from app.storage.ageing import quarantined_keys
from app.storage.database import Database
from app.storage.log import SqlObservationLog, find_session, logged_bytes
from app.storage.radio_maps import get_radio_map, load_radio_map

MAX_REPLAY_BYTES = 32 << 20
"""Some ten hours of scans, or four of raw inertial data: about half a minute of one core."""

# What is asked for now is mostly there by then.
_RETRY_AFTER_S = 5


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """What to run again: ``session`` is the phone's name, None the newest.

    ``profile`` and ``radio_map`` (an id) are in place of the session's and of the site's.
    """

    device_id: str
    session: str | None = None
    profile: str | None = None
    radio_map: str | None = None


class ReplayService:
    """Runs sessions again, one at a time: what phones post now comes first."""

    def __init__(self, database: Database, directory: SiteDirectory) -> None:
        self._database = database
        self._log = SqlObservationLog(database)
        self._directory = directory
        self._turn = asyncio.Lock()

    async def replay(self, principal: Principal, asked: ReplayRequest) -> list[SitePoint]:
        """Return the final track that a session has, or would have had.

        Raises
        ------
        AppError
            If there is no such session, profile or radio map, the session is too long, or another
            replay is running.
        """
        record = await self._session(principal, asked)
        params = choose_params(self._directory, record.site_id, asked.profile, record.profile)
        site = await self._site(record.site_id, asked.radio_map)
        if self._turn.locked():
            detail = "another replay is running"
            raise AppError(ErrorCode.TOO_MANY_REQUESTS, detail, retry_after_s=_RETRY_AFTER_S)
        async with self._turn:
            observations = await self._log.observations(record.session_id)
            points = await asyncio.to_thread(smoothed, observations, site, params)
        where = (asked.device_id, record.session_id, record.site_id)
        return [SitePoint(*where, p, record.session, TrackKind.SMOOTHED) for p in points]

    async def _session(self, principal: Principal, asked: ReplayRequest) -> SessionRecord:
        def statement(connection: Connection) -> tuple[SessionRecord | None, int]:
            record = find_session(connection, asked.device_id, asked.session)
            size = 0 if record is None else logged_bytes(connection, record.session_id)
            return record, size

        stored, size = await self._database.read(statement)
        record = found(stored, "session", asked.session or f"of {asked.device_id}")
        if not principal.covers_site(record.site_id):
            detail = f"the token is not for site {record.site_id!r}"
            raise AppError(ErrorCode.SITE_FORBIDDEN, detail)
        if size > MAX_REPLAY_BYTES:
            limit = f"{MAX_REPLAY_BYTES >> 20} MiB"
            detail = f"the session has {size >> 20} MiB of observations; at most {limit} run again"
            raise invalid_field(pointer="#/session", detail=detail)
        return record

    async def _site(self, site_id: str, radio_map_id: str | None) -> SiteModel:
        site = found(self._directory.current(site_id), "site", site_id)
        if radio_map_id is None:
            return site
        stored = await self._database.read(partial(get_radio_map, radio_map_id=radio_map_id))
        if stored is None or stored.site_id != site_id:
            detail = f"site {site_id!r} has no radio map {radio_map_id!r}"
            raise invalid_field(pointer="#/radio_map", detail=detail)
        radio_map = await self._database.read(partial(_matched_map, radio_map_id=radio_map_id))
        floor_ids = tuple(floor.floor_id for floor in site.floors)
        return replace(site, radio_map=fitted_map(radio_map, floor_ids))


def _matched_map(connection: Connection, radio_map_id: str) -> RadioMap | None:
    """Return a radio map as it would be matched with: without what is quarantined."""
    radio_map = load_radio_map(connection, radio_map_id)
    if radio_map is None:
        return None
    return radio_map.without_transmitters(quarantined_keys(connection, radio_map_id))
