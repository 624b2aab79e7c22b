"""Stored tracks: whole-second points of every session."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from sqlalchemy import Connection, Row, Select, and_, case, delete, func, select, tuple_

from app.core.session import LastPoint
from app.core.types import Method, MotionMode, TrackPoint, Used
from app.storage.database import Database
from app.storage.tables import FLOORS, SESSIONS, TRACK_POINTS
from app.storage.upsert import Values, upsert

# Points removed by retention in one transaction: short enough that no phone waits for it.
PURGE_STRIDE = 5000

# The last microsecond that 64 bits can tell.
_NEVER_US = 2**63 - 1

# Where the next page of a track starts: after this time_us of this session.
TrackCursor: TypeAlias = tuple[int, str]


@dataclass(frozen=True, slots=True)
class StoredPoint:
    """A track point with the device and the session it belongs to.

    ``smoothed`` says that the session is over and its track final: of all that it told, what came
    after the point too.
    """

    device_id: str
    session_id: str
    point: TrackPoint
    smoothed: bool = False

    @property
    def cursor(self) -> TrackCursor:
        """Return the cursor of the page after this point."""
        return _time_us(self.point.time_s), self.session_id


class SqlTrackStore:
    """Stores points in the order of the calls, without making the caller wait."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def write(self, session_id: str, points: Sequence[TrackPoint]) -> None:
        """Queue points; a point of the same session and time replaces the stored one."""
        self._database.submit(partial(_store, session_id, tuple(points)))

    def replace_from(self, session_id: str, from_s: float, points: Sequence[TrackPoint]) -> None:
        """Queue the removal of the session's points at or after ``from_s``, then these points."""
        self._database.submit(partial(_replace_from, session_id, from_s, tuple(points)))

    async def flush(self) -> None:
        """Wait until everything queued so far is stored."""
        await self._database.flush()

    async def last_points(self) -> list[LastPoint]:
        """Return where every device with a stored track was last known to be."""
        return await self._database.read(_last_points)


def read_track(
    connection: Connection,
    device_id: str,
    from_s: float,
    to_s: float,
    limit: int,
    after: TrackCursor | None = None,
) -> list[StoredPoint]:
    """Return a device's points in ``from_s <= time <= to_s`` by time, at most ``limit``."""
    key = (TRACK_POINTS.c.time_us, TRACK_POINTS.c.session_id)
    query = (
        _points()
        .where(SESSIONS.c.device_id == device_id)
        .where(TRACK_POINTS.c.time_us.between(_time_us(from_s), _time_us(to_s)))
        .order_by(*key)
        .limit(limit)
    )
    if after is not None:
        query = query.where(tuple_(*key) > after)
    return [_stored_point(row) for row in connection.execute(query)]


def fixes_at(
    connection: Connection, site_id: str, at_s: float, max_age_s: float
) -> list[StoredPoint]:
    """Return each device's last point at or before ``at_s``, if not older than ``max_age_s``."""
    newest_first = func.row_number().over(
        partition_by=SESSIONS.c.device_id,
        order_by=(TRACK_POINTS.c.time_us.desc(), SESSIONS.c.opened_s.desc()),
    )
    ranked = (
        _points(newest_first.label("rank"))
        .where(SESSIONS.c.site_id == site_id)
        # Lets the database find the instant by its index instead of walking every session.
        .where(TRACK_POINTS.c.floor_id.in_(select(FLOORS.c.id).where(FLOORS.c.site_id == site_id)))
        .where(TRACK_POINTS.c.time_us.between(_time_us(at_s - max_age_s), _time_us(at_s)))
        .subquery()
    )
    query = select(ranked).where(ranked.c.rank == 1).order_by(ranked.c.device_id)
    return [_stored_point(row) for row in connection.execute(query)]


async def purge_tracks(database: Database, site_id: str, before_s: float) -> int:
    """Remove the points of a site's finished sessions from before ``before_s``; return how many.

    A recording's points are as old as its session on this server: what it tells may be years old.
    """
    return await database.write_in_strides(partial(_purge_stride, site_id, before_s))


def _purge_stride(site_id: str, before_s: float, connection: Connection) -> int:
    # One limit per session lets the database find its old points by their key.
    before_us = case(
        (~SESSIONS.c.clock_recorded, _time_us(before_s)),
        (SESSIONS.c.opened_s < before_s, _NEVER_US),
        else_=0,
    )
    key = (TRACK_POINTS.c.session_id, TRACK_POINTS.c.time_us)
    old = (
        select(*key)
        .join_from(SESSIONS, TRACK_POINTS)
        .where(SESSIONS.c.site_id == site_id, SESSIONS.c.finished)
        .where(TRACK_POINTS.c.time_us < before_us)
        .limit(PURGE_STRIDE)
    )
    return connection.execute(delete(TRACK_POINTS).where(tuple_(*key).in_(old))).rowcount


def _last_points(connection: Connection) -> list[LastPoint]:
    # One look at each session's end: tracks have millions of points.
    end_us = (
        select(func.max(TRACK_POINTS.c.time_us))
        .where(TRACK_POINTS.c.session_id == SESSIONS.c.id)
        .scalar_subquery()
    )
    ends = select(
        SESSIONS.c.id, SESSIONS.c.device_id, SESSIONS.c.opened_s, end_us.label("time_us")
    ).subquery()
    newest_first = func.row_number().over(
        partition_by=ends.c.device_id, order_by=ends.c.opened_s.desc()
    )
    ranked = (
        select(ends.c.id, ends.c.time_us, newest_first.label("rank"))
        .where(ends.c.time_us.is_not(None))
        .subquery()
    )
    query = (
        _points(SESSIONS.c.site_id)
        .join(
            ranked,
            and_(
                TRACK_POINTS.c.session_id == ranked.c.id,
                TRACK_POINTS.c.time_us == ranked.c.time_us,
            ),
        )
        .where(ranked.c.rank == 1)
    )
    return [
        LastPoint(row.device_id, row.session_id, row.site_id, _stored_point(row).point)
        for row in connection.execute(query)
    ]


def _time_us(time_s: float) -> int:
    return round(time_s * 1e6)


def _store(session_id: str, points: tuple[TrackPoint, ...], connection: Connection) -> None:
    if points:
        upsert(connection, TRACK_POINTS, [_values(session_id, point) for point in points])


def _replace_from(
    session_id: str, from_s: float, points: tuple[TrackPoint, ...], connection: Connection
) -> None:
    connection.execute(
        delete(TRACK_POINTS).where(
            TRACK_POINTS.c.session_id == session_id, TRACK_POINTS.c.time_us >= _time_us(from_s)
        )
    )
    _store(session_id, points, connection)


def _points(*more: object) -> Select[tuple[object, ...]]:
    of_session = (SESSIONS.c.device_id, SESSIONS.c.finished)
    return select(*of_session, *TRACK_POINTS.c, *more).join_from(TRACK_POINTS, SESSIONS)


def _values(session_id: str, point: TrackPoint) -> Values:
    xx_m2, xy_m2, yy_m2 = point.covariance_m2
    return {
        "session_id": session_id,
        "time_us": _time_us(point.time_s),
        "time_s": point.time_s,
        "floor_id": point.floor_id,
        "x_m": point.x_m,
        "y_m": point.y_m,
        "covariance_xx_m2": xx_m2,
        "covariance_xy_m2": xy_m2,
        "covariance_yy_m2": yy_m2,
        "radius95_m": point.radius95_m,
        "speed_mps": point.speed_mps,
        "heading_rad": point.heading_rad,
        "motion": point.motion.value,
        "method": point.method.value,
        "floor_confidence": point.floor_confidence,
        "used_beacons": point.used.beacons,
        "used_access_points": point.used.access_points,
        "used_steps": point.used.steps,
        "age_s": point.age_s,
        "profile": point.profile,
        "zones": list(point.zones),
    }


def _stored_point(row: Row[tuple[object, ...]]) -> StoredPoint:
    point = TrackPoint(
        time_s=row.time_s,
        floor_id=row.floor_id,
        x_m=row.x_m,
        y_m=row.y_m,
        covariance_m2=(row.covariance_xx_m2, row.covariance_xy_m2, row.covariance_yy_m2),
        radius95_m=row.radius95_m,
        speed_mps=row.speed_mps,
        heading_rad=row.heading_rad,
        motion=MotionMode(row.motion),
        method=Method(row.method),
        floor_confidence=row.floor_confidence,
        used=Used(row.used_beacons, row.used_access_points, row.used_steps),
        age_s=row.age_s,
        profile=row.profile,
        zones=tuple(row.zones),
    )
    return StoredPoint(row.device_id, row.session_id, point, row.finished)
