"""Composition root: settings to storage, sessions, services, routes and pages; start and end."""

import asyncio
import logging
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI

from app.api.app import bind, mount_api
from app.api.context import ApiContext, ApiLimits
from app.config import Settings
from app.core.engine import warm_up
from app.services.ageing import AgeingService
from app.services.beacon_health import BeaconWatch
from app.services.first_start import make_first_token
from app.services.growth import GrowthService
from app.services.housekeeping import Housekeeping, Retention
from app.services.ingest import IngestService
from app.services.jobs import JobBoard
from app.services.planning_queue import PlanQueue
from app.services.radio_map_builds import RadioMapBuilds
from app.services.replay import ReplayService
from app.services.site import SiteDirectory
from app.services.survey_import import SurveyImporter
from app.services.survey_session import SessionSurveys
from app.services.survey_spool import Spool, own_temporary_folder
from app.services.survey_uploads import SurveyUploads
from app.services.tokens import Authenticator
from app.sessions.hub import Hub
from app.sessions.limits import SessionLimits
from app.sessions.ports import Clock, SessionPorts
from app.sessions.registry import SessionRegistry
from app.storage.database import Database
from app.storage.engines import sqlite_file
from app.storage.log import SqlObservationLog
from app.storage.migrate import current, head, upgrade
from app.storage.snapshots import SqlSnapshotStore
from app.storage.tokens import find_token
from app.storage.tracks import SqlTrackStore
from app.web.pages import mount_web

_LOG = logging.getLogger(__name__)

_DAY_S = 86_400.0
# A phone's answer to a close is a few round trips; whoever has not gone by then is cut off.
_SHUTDOWN_S = 10


class SystemClock:
    """The wall clock of this machine."""

    def now_s(self) -> float:
        """Return seconds since the Unix epoch."""
        return time.time()  # noqa: TID251 - this is the one Clock that everything else takes


class OutdatedDatabaseError(Exception):
    """The database has another schema than this build, and may not be migrated."""


def create_app(settings: Settings, clock: Clock | None = None) -> FastAPI:
    """Return the server; everything that runs is made when it starts and ended when it stops."""
    own_clock = clock or SystemClock()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await asyncio.to_thread(prepare_database, settings)
        await asyncio.to_thread(warm_up)
        database = Database(settings.database_url, edit_wait_s=settings.edit_wait_s)
        try:
            context, housekeeping = _build(settings, database, own_clock)
            await context.uploads.recover()
            await context.directory.refresh()
            await context.registry.recover()
            bind(app, context)
            await _announce(settings, database, own_clock)
            chores = [
                asyncio.create_task(chore)
                for chore in (
                    housekeeping.run(settings.sweep_interval_s),
                    context.uploads.sweep_on(),
                    context.watch.run(),
                )
            ]
            for chore in chores:
                chore.add_done_callback(_log_death)
            yield
            for chore in chores:
                chore.cancel()
            await context.builds.close()
            await context.growth.close()
            context.hub.close()
            await context.uploads.close()
            await context.registry.close()
            await context.watch.flush()
        finally:
            await database.close()

    app = FastAPI(
        title="Pharos",
        description="Indoor positioning: scans and steps in, tracks out.",
        version="1",
        lifespan=lifespan,
        # FastAPI's pages load scripts from elsewhere; a server in a cellar has no elsewhere.
        docs_url=None,
        redoc_url=None,
    )
    mount_api(app, settings.cors_origins)
    mount_web(app)
    return app


def run(settings: Settings) -> None:
    """Serve until interrupted; OutdatedDatabaseError if the database must be migrated first."""
    prepare_database(settings)
    uvicorn.run(create_app(settings), **uvicorn_options(settings))


def uvicorn_options(settings: Settings) -> dict[str, Any]:
    """Return how uvicorn serves the app, wherever it is run."""
    return {
        "host": settings.host,
        "port": settings.port,
        "log_level": settings.log_level,
        "access_log": False,
        "server_header": False,
        "ws": "websockets-sansio",
        "ws_max_size": settings.max_body_bytes,
        "ws_per_message_deflate": False,
        "ws_ping_interval": 20.0,
        "ws_ping_timeout": 20.0,
        "timeout_graceful_shutdown": _SHUTDOWN_S,
    }


def prepare_database(settings: Settings) -> None:
    """Bring the schema up to date, or refuse a database that may not be migrated and is not."""
    if settings.migrate:
        upgrade(settings.database_url)
        return
    found = current(settings.database_url)
    if found != head():
        msg = f"the database is at revision {found}, this build needs {head()}: run pharos migrate"
        raise OutdatedDatabaseError(msg)


def spool_folder(settings: Settings) -> Path:
    """Return where uploads are kept: as set, beside the SQLite file, or among temporary files."""
    if settings.spool_dir is not None:
        return Path(settings.spool_dir)
    beside = sqlite_file(settings.database_url)
    return own_temporary_folder() if beside is None else beside.with_name("pharos-uploads")


def _build(settings: Settings, database: Database, clock: Clock) -> tuple[ApiContext, Housekeeping]:
    directory = SiteDirectory(database)
    hub = Hub()
    ports = SessionPorts(
        SqlObservationLog(database, settings.ingest_wait_s),
        SqlSnapshotStore(database),
        SqlTrackStore(database),
    )
    limits = SessionLimits(evict_s=settings.session_evict_s, idle_s=settings.session_idle_s)
    registry = SessionRegistry(ports, directory, hub, clock, limits)
    board = JobBoard(database, hub, clock)
    importer = SurveyImporter(database, board, clock)
    watch = BeaconWatch(database, directory)
    context = ApiContext(
        clock=clock,
        database=database,
        directory=directory,
        registry=registry,
        hub=hub,
        ingest=IngestService(registry, hub, directory, database, clock, watch),
        watch=watch,
        replays=ReplayService(database, directory),
        growth=GrowthService(database, directory, board),
        authenticator=Authenticator(
            lambda token_hash: database.read(lambda c: find_token(c, token_hash)),
            clock,
            settings.token_cache_s,
        ),
        plans=PlanQueue(),
        builds=RadioMapBuilds(database, board),
        jobs=board,
        uploads=SurveyUploads(
            database, board, importer, Spool(spool_folder(settings)), settings.max_survey_bytes
        ),
        session_surveys=SessionSurveys(database, clock),
        ageing=AgeingService(database),
        limits=ApiLimits(
            settings.max_body_bytes, settings.max_decoded_bytes, settings.max_gzip_ratio
        ),
        cors_origins=settings.cors_origins,
        login_s=settings.login_s,
        cookie_secure=settings.cookie_secure,
    )
    retention = Retention(
        settings.imu_retention_s, settings.retention_days * _DAY_S, reopen_s=limits.reopen_s
    )
    chores = Housekeeping(registry, directory, database, clock, retention, context.ageing)
    return context, chores


async def _announce(settings: Settings, database: Database, clock: Clock) -> None:
    """On the first start, print the one admin token; it is nowhere to be found again."""
    token = await make_first_token(database, clock.now_s())
    if token is None:
        return
    host = "localhost" if settings.host in {"0.0.0.0", "::"} else settings.host  # noqa: S104
    base = settings.public_url or f"http://{host}:{settings.port}"
    sys.stdout.write(
        "First start: this admin token is shown once, keep it.\n"
        f"  token      {token}\n"
        f"  dashboard  {base}/#token={token}\n"
    )
    sys.stdout.flush()


def _log_death(task: "asyncio.Task[None]") -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _LOG.critical("a chore of the server has ended", exc_info=error)
