"""What a phone asks for before it posts: the time, the beacons to listen for, how to post."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from pydantic import BaseModel, Field

from app.api.auth import Principal, require
from app.api.context import context_of
from app.api.ingest_schema import MAX_READINGS, MAX_RECORDS, MAX_SAMPLES
from app.services.site_choice import choose_site

router = APIRouter(prefix="/v1", tags=["ingest"])

Anyone = Annotated[Principal, Depends(require())]


class ServerTime(BaseModel):
    """When the request came and when the reply left, for an NTP-like estimate."""

    t1_ms: float
    t2_ms: float


class BeaconUuids(BaseModel):
    """iBeacon UUIDs of a site: iOS hears only what is declared in advance."""

    site_id: str
    uuids: list[str]


class PhoneConfig(BaseModel):
    """How to post."""

    batch_ms: int = Field(1000, description="Gather records this long into one live batch.")
    max_records: int = MAX_RECORDS
    max_readings: int = MAX_READINGS
    max_samples: int = MAX_SAMPLES
    max_body_bytes: int
    retry_first_ms: int = Field(1000, description="Wait about this long before the first retry,")
    retry_longest_ms: int = Field(300_000, description="doubling up to this, with full jitter.")


@router.get("/time")
async def show_time(request: Request, _principal: Anyone) -> ServerTime:
    """Tell the server's time in milliseconds since 1970."""
    clock = context_of(request).clock
    came_ms = clock.now_s() * 1000.0
    return ServerTime(t1_ms=came_ms, t2_ms=clock.now_s() * 1000.0)


@router.get("/beacons/uuids")
async def list_uuids(
    request: Request, principal: Anyone, site_id: str | None = None
) -> BeaconUuids:
    """List the iBeacon UUIDs that a site's beacons use."""
    site = choose_site(context_of(request).directory, principal, site_id)
    uuids = {
        key.split(":")[1]
        for anchor in site.anchors
        for key in anchor.keys
        if key.startswith("ibeacon:")
    }
    return BeaconUuids(site_id=site.site_id, uuids=sorted(uuids))


@router.get("/config")
async def show_config(request: Request, _principal: Anyone) -> PhoneConfig:
    """Tell a phone how to post."""
    defaults: dict[str, Any] = {"max_body_bytes": context_of(request).limits.max_body_bytes}
    return PhoneConfig(**defaults)
