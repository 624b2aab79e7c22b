"""Watching beacons: when each was last heard, and what it told of its battery.

Every reading is looked up and kept in memory, one entry for each registered beacon; what is new is
written together every `WRITE_EVERY_S`, at the end of the server, and before somebody reads it, if
the database takes it then. So a reading costs no write, and a server that is killed forgets some
seconds.
"""

import asyncio
import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TypeAlias

from app.core.survey import Scan
from app.core.types import BeaconTelemetry, BleScan, Observation, WifiScan
from app.services.errors import AppError
from app.services.site import SiteDirectory
from app.services.writing import write
from app.storage.beacon_health import BeaconHealth, note_health
from app.storage.database import Database

_LOG = logging.getLogger(__name__)

WRITE_EVERY_S = 10.0
"""Batteries last for months and admins look daily; what a killed server forgets is not missed."""

READER_WAIT_S = 1.0
"""A reader waits so long for the newest: some hundred group commits, and no page seems to hang."""

_BEACONS_A_WRITE = 500
"""Beacons written in one go, some milliseconds: the observation log waits for its turn."""

Heard: TypeAlias = tuple[Observation, tuple[BeaconTelemetry, ...]]
"""An observation in event time, and what the beacons in it told of themselves."""


class BeaconWatch:
    """Gathers what traffic says of registered beacons."""

    def __init__(self, database: Database, directory: SiteDirectory) -> None:
        self._database = database
        self._directory = directory
        # Most readings are of beacons that tell nothing of themselves: their time is all.
        self._last_s: dict[str, float] = {}
        self._told: dict[str, BeaconHealth] = {}
        self._turn = asyncio.Lock()

    def note(self, site_id: str, heard: Iterable[Heard], received_s: float) -> None:
        """Keep what is newer than what is known; nothing was heard later than it was received."""
        ids = self._directory.beacon_ids_by_key(site_id)
        if not ids:
            return
        for observation, telemetry in heard:
            if isinstance(observation, WifiScan | BleScan):
                self._note_scan(ids, observation, received_s)
            for told in telemetry:
                told_s = min(observation.time_s, received_s)
                for beacon_id in {ids[key] for key in told.keys if key in ids}:
                    self._keep(_health(beacon_id, told_s, told))

    async def run(self) -> None:
        """Write every `WRITE_EVERY_S` until cancelled."""
        while True:
            await asyncio.sleep(WRITE_EVERY_S)
            try:
                await self.flush()
            except Exception:  # noqa: BLE001 - one bad write must not end all later ones
                _LOG.exception("what beacons told could not be stored; it is tried again")

    async def flush(self) -> None:
        """Write what is new.

        Raises
        ------
        AppError
            If the database does not take it now; nothing is forgotten.
        """
        async with self._turn:
            fresh = [
                replace(self._told.get(name, BeaconHealth(name, last_s)), last_heard_s=last_s)
                for name, last_s in self._last_s.items()
            ]
            self._last_s, self._told = {}, {}
            for first in range(0, len(fresh), _BEACONS_A_WRITE):
                some = fresh[first : first + _BEACONS_A_WRITE]
                try:
                    await write(self._database, partial(note_health, heard=some))
                except BaseException:
                    for health in fresh[first:]:
                        self._keep(health)
                    raise

    async def flush_for_reader(self) -> None:
        """Write what is new before somebody reads it.

        While the database does not take it, what is stored is read: some seconds older at first.
        """
        try:
            async with asyncio.timeout(READER_WAIT_S):
                await self.flush()
        except (AppError, TimeoutError) as error:
            reason = str(error) or f"no commit within {READER_WAIT_S} s"
            _LOG.warning("what beacons told last is not stored yet: %s", reason)

    def _note_scan(self, ids: Mapping[str, str], scan: Scan, received_s: float) -> None:
        for reading in scan.readings:
            heard_s = min(scan.time_s - reading.age_s, received_s)
            for key in reading.keys:
                if key in ids:
                    self._hear(ids[key], heard_s)

    def _hear(self, beacon_id: str, heard_s: float) -> None:
        if heard_s > self._last_s.get(beacon_id, -math.inf):
            self._last_s[beacon_id] = heard_s

    def _keep(self, fresh: BeaconHealth) -> None:
        self._hear(fresh.beacon_id, fresh.last_heard_s)
        if fresh.told_s is not None:
            known = self._told.get(fresh.beacon_id)
            self._told[fresh.beacon_id] = fresh if known is None else _joined(known, fresh)


def _health(beacon_id: str, told_s: float, told: BeaconTelemetry) -> BeaconHealth:
    return BeaconHealth(
        beacon_id, told_s, told_s, told.battery_percent, told.battery_v, told.temperature_degc
    )


def _joined(known: BeaconHealth, fresh: BeaconHealth) -> BeaconHealth:
    older, newer = sorted((known, fresh), key=lambda health: health.told_s or 0.0)
    return replace(
        newer,
        battery_percent=_first(newer.battery_percent, older.battery_percent),
        battery_v=_first(newer.battery_v, older.battery_v),
        temperature_degc=_first(newer.temperature_degc, older.temperature_degc),
    )


def _first(newer: float | None, older: float | None) -> float | None:
    return older if newer is None else newer
