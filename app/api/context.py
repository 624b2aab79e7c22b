"""What routes work with: built once by main, reached from any request or socket."""

from dataclasses import dataclass
from typing import cast

from starlette.requests import HTTPConnection

from app.services.ageing import AgeingService
from app.services.beacon_health import BeaconWatch
from app.services.growth import GrowthService
from app.services.ingest import IngestService
from app.services.jobs import JobBoard
from app.services.planning_queue import PlanQueue
from app.services.radio_map_builds import RadioMapBuilds
from app.services.replay import ReplayService
from app.services.site import SiteDirectory
from app.services.survey_session import SessionSurveys
from app.services.survey_uploads import SurveyUploads
from app.services.tokens import Authenticator
from app.sessions.hub import Hub
from app.sessions.ports import Clock
from app.sessions.registry import SessionRegistry
from app.storage.database import Database


@dataclass(frozen=True, slots=True)
class ApiLimits:
    """Bounds on what a client may send."""

    max_body_bytes: int = 1 << 20
    max_decoded_bytes: int = 8 << 20
    max_gzip_ratio: int = 100


@dataclass(frozen=True, slots=True)
class ApiContext:
    """The running server's parts that the routes use."""

    clock: Clock
    database: Database
    directory: SiteDirectory
    registry: SessionRegistry
    hub: Hub
    ingest: IngestService
    watch: BeaconWatch
    replays: ReplayService
    growth: GrowthService
    authenticator: Authenticator
    plans: PlanQueue
    builds: RadioMapBuilds
    jobs: JobBoard
    uploads: SurveyUploads
    session_surveys: SessionSurveys
    ageing: AgeingService
    limits: ApiLimits
    cors_origins: tuple[str, ...]
    login_s: float
    cookie_secure: bool


def context_of(connection: HTTPConnection) -> ApiContext:
    """Return the running server's parts; usable as a FastAPI dependency."""
    return cast("ApiContext", connection.app.state.context)
