"""Everything under ``/v1`` and its description, put onto one FastAPI application."""

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from app.api import (
    beacon_tables,
    beacons,
    calibrations,
    devices,
    floors,
    georeference,
    growth,
    health,
    ingest,
    jobs,
    locate,
    login,
    map_features,
    phones,
    planner,
    profiles,
    radio_map_quality,
    radio_maps,
    replay,
    sites,
    stream,
    surveys,
    tokens,
    tracks,
)
from app.api.context import ApiContext
from app.api.errors import install_handlers
from app.api.head import HeadMiddleware
from app.api.openapi import install_openapi
from app.api.request_id import REQUEST_ID_HEADER, RequestIdMiddleware

# A fixed path must come before one with a placeholder: phones' /v1/beacons/uuids before beacons.
ROUTERS = (
    health.router,
    login.router,
    phones.router,
    ingest.router,
    locate.router,
    stream.router,
    sites.router,
    georeference.router,
    growth.router,
    floors.router,
    map_features.router,
    planner.router,
    calibrations.floor_router,
    calibrations.router,
    beacon_tables.router,
    beacons.router,
    radio_maps.router,
    radio_maps.rollback_router,
    surveys.router,
    jobs.router,
    radio_map_quality.router,
    profiles.router,
    tokens.router,
    devices.router,
    tracks.router,
    replay.router,
)


def mount_api(app: FastAPI, cors_origins: tuple[str, ...]) -> None:
    """Add routes, error shape, request ids, CORS and OpenAPI to ``app``."""
    for router in ROUTERS:
        app.include_router(router)
    install_handlers(app)
    install_openapi(app)
    app.add_middleware(HeadMiddleware)
    if cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(cors_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=[
                "ETag",
                "Link",
                "Location",
                "Retry-After",
                "Upload-Offset",
                REQUEST_ID_HEADER,
            ],
        )
    app.add_middleware(RequestIdMiddleware)


def bind(app: FastAPI, context: ApiContext) -> None:
    """Give the routes the running server's parts."""
    app.state.context = context
