"""Ageing of radio maps: live traffic is held against the map that it is matched with."""

import asyncio
from collections.abc import Sequence
from itertools import islice

from sqlalchemy import Connection

from app.core.fingerprint.ageing import (
    AgeingParams,
    Suspect,
    appeared,
    find_aged,
)
from app.core.fingerprint.contradiction import learned_weights
from app.core.fingerprint.query import Query, first_of
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.survey import scan_levels
from app.core.params import MatchParams
from app.core.types import Observation
from app.services.errors import AppError, ErrorCode, found
from app.storage import ageing, radio_maps
from app.storage.ageing import AgedTransmitter
from app.storage.database import Database
from app.storage.radio_maps import StoredRadioMap

TRAFFIC_S = 14.0 * 86_400.0
"""How far back traffic tells of the map: a fortnight has every weekday twice."""

MAX_SCANS = 20_000
"""Scans looked at, the newest: a few seconds of one core."""


class AgeingService:
    """Looks at one map at a time: what phones post now comes first."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._turn = asyncio.Lock()

    async def look(self, radio_map_id: str, now_s: float) -> list[AgedTransmitter]:
        """Find what traffic contradicts, store it, and return the list.

        Raises
        ------
        AppError
            If there is no such map.
        """
        stored, radio_map, traffic = await self._database.read(
            lambda c: _loaded(c, radio_map_id, now_s)
        )
        async with self._turn:
            suspects = await asyncio.to_thread(suspects_in, traffic, radio_map)

        def store(connection: Connection) -> list[AgedTransmitter]:
            found(radio_maps.get_radio_map(connection, radio_map_id), "radio map", radio_map_id)
            ageing.replace_suspects(connection, radio_map_id, suspects, now_s)
            return ageing.list_aged(connection, stored.radio_map_id)

        return await self._database.write(store)

    async def look_at_site(self, site_id: str, now_s: float) -> None:
        """Look at a site's active radio map, if it has one."""
        maps = await self._database.read(
            lambda c: radio_maps.list_radio_maps(c, site_id=site_id, active=True, limit=1)
        )
        for stored in maps:
            await self.look(stored.radio_map_id, now_s)

    async def quarantine(
        self, radio_map_id: str, quarantined: Sequence[str], released: Sequence[str]
    ) -> list[AgedTransmitter]:
        """Leave listed transmitters out of matching, and take others in again.

        Raises
        ------
        AppError
            If one of them is not listed, or is to be both; then nothing is changed.
        """
        if both := sorted(set(quarantined) & set(released)):
            detail = f"{both[0]!r} cannot be both quarantined and released"
            raise AppError(ErrorCode.INVALID_FIELD, detail)

        def statement(connection: Connection) -> list[AgedTransmitter]:
            listed = {aged.suspect.key for aged in ageing.list_aged(connection, radio_map_id)}
            if unknown := sorted({*quarantined, *released} - listed):
                detail = f"{unknown[0]!r} is not among the aged transmitters of the radio map"
                raise AppError(ErrorCode.INVALID_FIELD, detail)
            ageing.set_quarantine(connection, radio_map_id, quarantined, quarantined=True)
            ageing.set_quarantine(connection, radio_map_id, released, quarantined=False)
            return ageing.list_aged(connection, radio_map_id)

        return await self._database.write(statement)


def suspects_in(traffic: Sequence[Sequence[Observation]], radio_map: RadioMap) -> list[Suspect]:
    """Return what the traffic of several sessions contradicts, and what is new in it."""
    matching, params = MatchParams(), AgeingParams()
    rule = first_of(radio_map.column_by_key), matching
    sessions: list[list[Query]] = []
    left = MAX_SCANS
    for session in traffic:
        levels = islice(scan_levels(session, rule), left)
        sessions.append([Query(wifi_dbm, ble_dbm) for _, wifi_dbm, ble_dbm in levels])
        left -= len(sessions[-1])
    if left == MAX_SCANS:
        return []
    weights = learned_weights(radio_map, matching)
    aged = find_aged(sessions, radio_map, weights, matching, params)
    return aged + appeared(sessions, radio_map, params)


def _loaded(
    connection: Connection, radio_map_id: str, now_s: float
) -> tuple[StoredRadioMap, RadioMap, list[list[Observation]]]:
    stored = found(radio_maps.get_radio_map(connection, radio_map_id), "radio map", radio_map_id)
    radio_map = found(
        radio_maps.load_radio_map(connection, radio_map_id), "radio map", radio_map_id
    )
    since_s = max(now_s - TRAFFIC_S, stored.created_s)
    return stored, radio_map, ageing.traffic(connection, stored.site_id, since_s)
