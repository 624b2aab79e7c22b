"""What a server does beside answering: end silent sessions, see edits, forget what is old.

Where a site's radio map may grow, finished sessions are kept aside before they are forgotten.
"""

import asyncio
import logging
from dataclasses import dataclass
from functools import partial

from app.core.session import LogUnavailableError
from app.services.ageing import AgeingService
from app.services.growth import take_finished_aside
from app.services.site import SiteDirectory
from app.sessions.limits import SessionLimits
from app.sessions.ports import Clock
from app.sessions.registry import SessionRegistry
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.quarantine import expire
from app.storage.retention import purge_imu, purge_observations
from app.storage.sites import get_site
from app.storage.tracks import purge_tracks

_LOG = logging.getLogger(__name__)
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class Retention:
    """How long what is kept, and how often that is looked after.

    ``kept_s`` is of scans, steps and tracks at a site that says nothing itself. For ``reopen_s``
    after its opening a session may be opened again.
    """

    imu_s: float = _DAY_S
    kept_s: float = 90.0 * _DAY_S
    interval_s: float = 3600.0
    reopen_s: float = SessionLimits().reopen_s


class Housekeeping:
    """The periodic work; `run` goes on until it is cancelled."""

    def __init__(
        self,
        registry: SessionRegistry,
        directory: SiteDirectory,
        database: Database,
        clock: Clock,
        retention: Retention,
        ageing: AgeingService,
    ) -> None:
        self._registry = registry
        self._directory = directory
        self._database = database
        self._clock = clock
        self._retention = retention
        self._purged_s = -1.0
        self._ageing = ageing
        # The first look is due at once: a server that is restarted daily would never have one.
        self._aged_s = -_DAY_S

    async def run(self, interval_s: float) -> None:
        """Do a round every ``interval_s``; one that fails is logged, and the next goes on."""
        while True:
            await asyncio.sleep(interval_s)
            try:
                await self.round()
            except (DatabaseUnavailableError, LogUnavailableError) as error:
                _LOG.warning("housekeeping is put off: %s", error)
            except Exception:  # noqa: BLE001 - one bad round must not end all later ones
                _LOG.exception("a round of housekeeping has failed; the next one goes on")

    async def round(self) -> None:
        """Do everything that is due."""
        await self._directory.refresh()
        await self._registry.sweep()
        await self._take_aside()
        if self._clock.now_s() >= self._purged_s + self._retention.interval_s:
            await self._purge()
            self._purged_s = self._clock.now_s()
        if self._clock.now_s() >= self._aged_s + _DAY_S:
            self._aged_s = self._clock.now_s()
            for site_id in self._directory.site_ids():
                await self._ageing.look_at_site(site_id, self._aged_s)

    async def _take_aside(self) -> None:
        for site_id in self._directory.site_ids():
            if self._directory.grows_map(site_id):
                now_s = self._clock.now_s()
                await take_finished_aside(self._database, self._directory, site_id, now_s)

    async def _purge(self) -> None:
        now_s = self._clock.now_s()
        await purge_imu(self._database, now_s - self._retention.imu_s)
        for site_id in self._directory.site_ids():
            site = await self._database.read(partial(get_site, site_id=site_id))
            if site is None:
                continue
            days = site.retention_days
            kept_s = self._retention.kept_s if days is None else days * _DAY_S
            over_s = now_s - self._retention.reopen_s
            await purge_observations(self._database, site_id, now_s - kept_s, over_s)
            await purge_tracks(self._database, site_id, now_s - kept_s)
            before_s = now_s - kept_s
            await self._database.write(
                partial(expire, site_id=site_id, before_s=before_s, decided_s=now_s)
            )
