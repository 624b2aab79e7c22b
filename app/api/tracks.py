"""``/v1/fixes`` and ``/v1/devices/{id}/track``: where everybody is, and where somebody was."""

import re
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BeforeValidator, WithJsonSchema

from app.api.auth import check_site
from app.api.context import ApiContext
from app.api.devices import OwnReader, device_in_scope
from app.api.fix import fix_json, iso_time
from app.api.fix_openapi import FIXES_REPLY, TRACK_REPLY
from app.api.negotiation import best_type
from app.api.paging import decode_cursor, encode_cursor
from app.api.resource import Context, Instant, Reader, registry_router
from app.api.track_formats import track_csv, track_geojson, track_gpx
from app.core.types import TrackPoint
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.tracks import SitePoint, TrackPage, TrackQuery, fixes_of_site_at, read_page
from app.storage.tracks import TrackCursor

router = registry_router("/v1", "tracks")

MEDIA_TYPES = ("application/json", "application/geo+json", "text/csv", "application/gpx+xml")

MAX_TRACK_LIMIT = 10_000
"""Almost three hours at one point a second; 4 MB of JSON."""

# Far beyond every recording, and whole microseconds of it still fit 64 bits.
_END_OF_TIME_S = 1e11

_UNIT_S = {"ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_TRACK_KEY = re.compile(r"(\d{1,17}) ([\w-]+)", re.ASCII)
_SPAN = re.compile(r"(\d{1,6}(?:\.\d{1,3})?)(ms|s|m|h)")


def _span_s(text: str) -> float:
    match = _SPAN.fullmatch(text)
    span_s = float(match[1]) * _UNIT_S[match[2]] if match else 0.0
    if span_s < 1e-3:
        msg = "a span of time, as 500ms, 5s, 1m or 1h"
        raise ValueError(msg)
    return span_s


Span = Annotated[
    float,
    BeforeValidator(_span_s),
    WithJsonSchema({"type": "string", "pattern": r"^\d{1,6}(\.\d{1,3})?(ms|s|m|h)$"}),
]


@router.get("/fixes", responses={200: FIXES_REPLY})
async def list_fixes(
    principal: Reader,
    context: Context,
    site_id: str | None = None,
    floor_id: str | None = None,
    at: Annotated[Instant | None, Query(description="A past instant; left out: now")] = None,
    max_age_s: Annotated[
        float, Query(gt=0, le=3600, description="How long before `at` a fix may have been")
    ] = 60.0,
) -> dict[str, Any]:
    """List where all devices are that have a fix, by device id."""
    if site_id is not None:
        check_site(principal, site_id)
        found(context.directory.current(site_id), "site", site_id)
    asked = site_id or principal.site_id
    sites = [asked] if asked is not None else sorted(context.directory.site_ids())
    points: list[SitePoint] = []
    for site in sites:
        points += await _points_at(context, site, at, max_age_s)
    items = [
        _json(context, located)
        for located in sorted(points, key=lambda p: p.device_id)
        if floor_id in {None, located.point.floor_id}
    ]
    return {"items": items, "next_cursor": None}


@dataclass(frozen=True, slots=True)
class TrackRequest:
    """The parameters of a track."""

    from_s: float
    to_s: float
    limit: int
    after: TrackCursor | None
    every_s: float | None
    simplify_m: float | None


def track_request(
    from_: Annotated[Instant | None, Query(alias="from", description="First instant")] = None,
    to: Annotated[Instant | None, Query(description="End, itself left out")] = None,
    every: Annotated[
        Span | None, Query(description="Keep the first point of each such span, as `5s`")
    ] = None,
    simplify: Annotated[
        float | None,
        Query(ge=0, le=100, allow_inf_nan=False, description="Metres the line may move by"),
    ] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_TRACK_LIMIT)] = 1000,
    cursor: Annotated[str | None, Query(max_length=400)] = None,
) -> TrackRequest:
    """Return what the query parameters of a track ask for."""
    from_s = 0.0 if from_ is None else from_.timestamp()
    to_s = _END_OF_TIME_S if to is None else to.timestamp()
    if to_s <= from_s:
        raise invalid_field(pointer="query:to", detail="to is not after from")
    after = None if cursor is None else _track_cursor(cursor)
    return TrackRequest(from_s, to_s, limit, after, every, simplify)


@router.get("/devices/{device_id}/track", responses={200: TRACK_REPLY})
async def get_track(
    device_id: str,
    principal: OwnReader,
    context: Context,
    request: Request,
    asked: Annotated[TrackRequest, Depends(track_request)],
) -> Response:
    """Return a device's track between two instants, complete up to its newest batch.

    By Accept as JSON, GeoJSON, CSV or GPX; the next page is `next_cursor`, and a Link header.
    """
    media_type = best_type(request, MEDIA_TYPES)
    await device_in_scope(context, principal, device_id)
    query = TrackQuery(
        device_id,
        asked.from_s,
        asked.to_s,
        asked.limit,
        asked.after,
        asked.every_s,
        asked.simplify_m,
        principal.site_id,
    )
    page = await read_page(context.database, context.registry, query)
    return track_response(request, context, media_type, page)


def track_response(
    request: Request, context: ApiContext, media_type: str, page: TrackPage
) -> Response:
    """Return a page of a track in a form of `MEDIA_TYPES`."""
    next_cursor = None
    if page.next_after is not None:
        time_us, session_id = page.next_after
        next_cursor = encode_cursor(f"{time_us} {session_id}")
    headers = {"Vary": "Accept"}
    if next_cursor is not None:
        url = request.url.include_query_params(cursor=next_cursor)
        headers["Link"] = f'<{url.path}?{url.query}>; rel="next"'
    georeference_of = context.directory.georeference
    content: object
    match media_type:
        case "text/csv":
            return Response(track_csv(page.points, georeference_of), 200, headers, media_type)
        case "application/gpx+xml":
            return Response(track_gpx(page.points, georeference_of), 200, headers, media_type)
        case "application/geo+json":
            content = track_geojson(page.points, georeference_of, next_cursor)
        case _:
            items = [_json(context, located) for located in page.points]
            content = {"items": items, "next_cursor": next_cursor, "sessions": _sessions(page)}
    return JSONResponse(content, 200, headers, media_type)


async def _points_at(
    context: ApiContext, site_id: str, at: datetime | None, max_age_s: float
) -> list[SitePoint]:
    site = context.directory.current(site_id)
    if site is None:
        return []
    if at is not None:
        instant_s = at.timestamp()
        return await fixes_of_site_at(
            context.database, context.registry, site, instant_s, max_age_s
        )
    latest = context.registry.latest_at(site_id)
    return [
        SitePoint(device_id, "", site_id, output)
        for device_id, output in latest.items()
        if isinstance(output, TrackPoint)
    ]


def _sessions(page: TrackPage) -> list[dict[str, Any]]:
    """Return what sessions the points are of, and what kind of track each has."""
    by_session: dict[str, list[SitePoint]] = {}
    for located in page.points:
        by_session.setdefault(located.session_id, []).append(located)
    return [
        {
            "session": points[0].session,
            "kind": points[-1].kind.value,
            "first": iso_time(points[0].point.time_s),
            "last": iso_time(points[-1].point.time_s),
            "points": len(points),
        }
        for points in by_session.values()
    ]


def _json(context: ApiContext, located: SitePoint) -> dict[str, Any]:
    georeference = context.directory.georeference(located.site_id)
    return fix_json(located.device_id, located.site_id, located.point, georeference)


def _track_cursor(cursor: str) -> TrackCursor:
    match = _TRACK_KEY.fullmatch(decode_cursor(cursor))
    if match is None:
        raise AppError(ErrorCode.INVALID_CURSOR, "the cursor is not one of a track")
    return int(match[1]), match[2]
