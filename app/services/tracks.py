"""Reading where devices are and were: stored tracks joined with what live sessions hold."""

import math
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import groupby

import numpy as np

from app.core.geometry import simplify_line
from app.core.site import SiteModel
from app.core.types import TrackPoint
from app.sessions.registry import SessionRegistry
from app.storage.database import Database
from app.storage.devices import sessions_of_device
from app.storage.tracks import StoredPoint, TrackCursor, fixes_at, read_track

CHUNK = 2000
"""Points read at once: half an hour, a few milliseconds."""


class TrackKind(StrEnum):
    """What a point of a track rests on: what came before it, or all of its session."""

    CAUSAL = "causal"
    SMOOTHED = "smoothed"


@dataclass(frozen=True, slots=True)
class SitePoint:
    """A track point with where and of whom it is; ``session`` is the phone's name for it."""

    device_id: str
    session_id: str
    site_id: str
    point: TrackPoint
    session: str = ""
    kind: TrackKind = TrackKind.CAUSAL


@dataclass(frozen=True, slots=True)
class TrackQuery:
    """Which part of a device's track, and how much of it.

    Attributes
    ----------
    from_s, to_s
        Half-open interval.
    every_s
        Keep the first point of each interval of this length; None keeps all.
    simplify_m
        Leave out points as long as the line moves by no more than this; None keeps all.
    site_id
        Only points at this site; None: anywhere.
    """

    device_id: str
    from_s: float
    to_s: float
    limit: int
    after: TrackCursor | None = None
    every_s: float | None = None
    simplify_m: float | None = None
    site_id: str | None = None


@dataclass(frozen=True, slots=True)
class TrackPage:
    """Part of a track by time; ``next_after`` is None when it is the last part."""

    points: tuple[SitePoint, ...]
    next_after: TrackCursor | None


async def read_page(database: Database, registry: SessionRegistry, query: TrackQuery) -> TrackPage:
    """Return a page of a device's track, complete up to the newest batch taken."""
    await registry.settle(query.device_id)
    sessions = await database.read(lambda c: sessions_of_device(c, query.device_id))
    sites = {session_id: site_id for session_id, (site_id, _) in sessions.items()}
    kept: list[StoredPoint] = []
    bucket = _bucket_of_cursor(query)
    async for stored in _joined(database, registry, query):
        if query.site_id not in {None, sites.get(stored.session_id)}:
            continue
        if query.every_s is not None:
            if _bucket(stored.cursor, query.every_s) == bucket:
                continue
            bucket = _bucket(stored.cursor, query.every_s)
        kept.append(stored)
        if len(kept) > query.limit:
            break
    page = kept[: query.limit]
    points = [_site_point(p, *sessions[p.session_id]) for p in page if p.session_id in sessions]
    if query.simplify_m is not None:
        points = simplified(points, query.simplify_m)
    return TrackPage(tuple(points), page[-1].cursor if len(kept) > query.limit else None)


async def fixes_of_site_at(
    database: Database, registry: SessionRegistry, site: SiteModel, at_s: float, max_age_s: float
) -> list[SitePoint]:
    """Return where each device of a site was at an instant, if it was known shortly before."""
    floor_ids = {floor.floor_id for floor in site.floors}
    held = [
        StoredPoint(device_id, session_id, point)
        for device_id in registry.latest_at(site.site_id)
        for session_id, points in registry.pending_points(device_id).items()
        for point in points
        if at_s - max_age_s <= point.time_s <= at_s and point.floor_id in floor_ids
    ]
    stored = await database.read(lambda c: fixes_at(c, site.site_id, at_s, max_age_s))
    newest: dict[str, StoredPoint] = {}
    for candidate in sorted([*stored, *held], key=lambda p: p.cursor):
        newest[candidate.device_id] = candidate
    return [
        SitePoint(p.device_id, p.session_id, site.site_id, p.point)
        for _, p in sorted(newest.items())
    ]


def simplified(points: Sequence[SitePoint], tolerance_m: float) -> list[SitePoint]:
    """Thin each stretch on one floor in one session by `simplify_line`."""
    kept: list[SitePoint] = []
    for _, group in groupby(points, key=lambda p: (p.session_id, p.point.floor_id)):
        stretch = list(group)
        xy_m = np.array([(p.point.x_m, p.point.y_m) for p in stretch], dtype=np.float64)
        keep = simplify_line(xy_m, tolerance_m)
        kept += [p for p, wanted in zip(stretch, keep, strict=True) if wanted]
    return kept


def _site_point(stored: StoredPoint, site_id: str, session: str) -> SitePoint:
    kind = TrackKind.SMOOTHED if stored.smoothed else TrackKind.CAUSAL
    return SitePoint(stored.device_id, stored.session_id, site_id, stored.point, session, kind)


async def _joined(
    database: Database, registry: SessionRegistry, query: TrackQuery
) -> AsyncIterator[StoredPoint]:
    """Yield stored and pending points in the order of their cursors."""
    pending = _pending(registry, query)
    replaced = {p.cursor for p in pending}
    after = query.after
    while True:
        read = partial(
            read_track,
            device_id=query.device_id,
            from_s=query.from_s,
            to_s=query.to_s,
            limit=CHUNK,
            after=after,
        )
        chunk = await database.read(read)
        last = chunk[-1].cursor if len(chunk) == CHUNK else (math.inf, "")
        ready = [p for p in pending if p.cursor <= last]
        pending = pending[len(ready) :]
        stored = (p for p in chunk if p.point.time_s < query.to_s and p.cursor not in replaced)
        for point in sorted([*stored, *ready], key=lambda p: p.cursor):
            yield point
        if len(chunk) < CHUNK:
            return
        after = chunk[-1].cursor


def _pending(registry: SessionRegistry, query: TrackQuery) -> list[StoredPoint]:
    points = [
        StoredPoint(query.device_id, session_id, point)
        for session_id, held in registry.pending_points(query.device_id).items()
        for point in held
        if query.from_s <= point.time_s < query.to_s
    ]
    after = query.after or (-math.inf, "")
    return sorted((p for p in points if p.cursor > after), key=lambda p: p.cursor)


def _bucket(cursor: TrackCursor, every_s: float) -> tuple[str, int]:
    time_us, session_id = cursor
    return session_id, time_us // round(every_s * 1e6)


def _bucket_of_cursor(query: TrackQuery) -> tuple[str, int] | None:
    """Return the interval that the page before ended in: its point is kept already."""
    if query.after is None or query.every_s is None:
        return None
    return _bucket(query.after, query.every_s)
