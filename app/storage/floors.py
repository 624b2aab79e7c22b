"""Floors as stored: their frame, plan image, map and walkable raster."""

import hashlib
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, delete, insert, select, update

from app.core.geometry import Walkable
from app.storage.codec import VariantCodec
from app.storage.rows import unique, update_row
from app.storage.tables import FLOORS

_WALKABLE: VariantCodec[Walkable] = VariantCodec({"walkable": Walkable})


@dataclass(frozen=True, slots=True)
class StoredFloor:
    """One floor, without its image and map.

    ``x0_m, y0_m`` is the lower left corner of its plan in the site frame.
    """

    floor_id: str
    site_id: str
    name: str
    ordinal: int
    width_m: float
    height_m: float
    building: str = ""
    x0_m: float = 0.0
    y0_m: float = 0.0
    plan_media_type: str | None = None
    has_map: bool = False
    row_version: int = 1


@dataclass(frozen=True, slots=True)
class PlanImage:
    """The picture of a floor."""

    media_type: str
    image: bytes

    @property
    def digest(self) -> str:
        """Return the hash of the picture: its ETag."""
        return hashlib.sha256(self.image).hexdigest()[:32]


_LISTED = (
    FLOORS.c.id,
    FLOORS.c.site_id,
    FLOORS.c.name,
    FLOORS.c.building,
    FLOORS.c.ordinal,
    FLOORS.c.x0_m,
    FLOORS.c.y0_m,
    FLOORS.c.width_m,
    FLOORS.c.height_m,
    FLOORS.c.plan_media_type,
    FLOORS.c.map.is_not(None).label("has_map"),
    FLOORS.c.row_version,
)


def list_floors(
    connection: Connection, *, site_id: str | None, after: str | None, limit: int
) -> list[StoredFloor]:
    """Return up to ``limit + 1`` floors by id, of one site or all."""
    query = select(*_LISTED).order_by(FLOORS.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(FLOORS.c.site_id == site_id)
    if after is not None:
        query = query.where(FLOORS.c.id > after)
    return [_floor(row) for row in connection.execute(query).mappings()]


def floors_of_site(connection: Connection, site_id: str) -> list[StoredFloor]:
    """Return all floors of a site in the order that `SiteModel.floors` has."""
    query = (
        select(*_LISTED)
        .where(FLOORS.c.site_id == site_id)
        .order_by(FLOORS.c.building, FLOORS.c.ordinal, FLOORS.c.id)
    )
    return [_floor(row) for row in connection.execute(query).mappings()]


def get_floor(connection: Connection, floor_id: str) -> StoredFloor | None:
    """Return a floor, None if there is none of this id."""
    query = select(*_LISTED).where(FLOORS.c.id == floor_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _floor(row)


def insert_floor(connection: Connection, floor: StoredFloor) -> StoredFloor:
    """Store a new floor; plan and map come later."""
    with unique(f"floor {floor.floor_id!r}, or its name in this building,"):
        connection.execute(
            insert(FLOORS).values(id=floor.floor_id, site_id=floor.site_id, **_editable(floor))
        )
    return floor


def update_floor(connection: Connection, floor: StoredFloor) -> int:
    """Store the edited frame and names of a floor read as ``row_version``; return the new one."""
    with unique(f"a floor named {floor.name!r} of building {floor.building!r}"):
        return update_row(connection, FLOORS, floor.floor_id, floor.row_version, _editable(floor))


def delete_floor(connection: Connection, floor_id: str) -> None:
    """Remove a floor; its beacons stay, without a place."""
    connection.execute(delete(FLOORS).where(FLOORS.c.id == floor_id))


def get_plan(connection: Connection, floor_id: str) -> PlanImage | None:
    """Return the picture of a floor, None if it has none."""
    query = select(FLOORS.c.plan_media_type, FLOORS.c.plan_image).where(FLOORS.c.id == floor_id)
    row = connection.execute(query).one_or_none()
    if row is None or row.plan_image is None:
        return None
    return PlanImage(row.plan_media_type, row.plan_image)


def set_plan(connection: Connection, floor_id: str, plan: PlanImage | None) -> None:
    """Replace or remove the picture; no coordinate moves."""
    connection.execute(
        update(FLOORS)
        .where(FLOORS.c.id == floor_id)
        .values(
            plan_media_type=plan and plan.media_type,
            plan_image=plan and plan.image,
            row_version=FLOORS.c.row_version + 1,
        )
    )


def get_map(connection: Connection, floor_id: str) -> dict[str, Any] | None:
    """Return the map of a floor as it was given (see `app.formats.floor_map`)."""
    return connection.execute(select(FLOORS.c.map).where(FLOORS.c.id == floor_id)).scalar()


def get_walkable(connection: Connection, floor_id: str) -> Walkable | None:
    """Return the raster of where people can walk on a floor."""
    payload = connection.execute(select(FLOORS.c.walkable).where(FLOORS.c.id == floor_id)).scalar()
    return None if payload is None else _WALKABLE.decode(payload)[0]


def set_map(
    connection: Connection,
    floor_id: str,
    document: dict[str, Any] | None,
    walkable: Walkable | None,
) -> None:
    """Replace or remove the map of a floor together with the raster made from it."""
    connection.execute(
        update(FLOORS)
        .where(FLOORS.c.id == floor_id)
        .values(
            map=document,
            walkable=None if walkable is None else _WALKABLE.encode([walkable]),
            row_version=FLOORS.c.row_version + 1,
        )
    )


def _editable(floor: StoredFloor) -> dict[str, Any]:
    return {
        "name": floor.name,
        "building": floor.building,
        "ordinal": floor.ordinal,
        "x0_m": floor.x0_m,
        "y0_m": floor.y0_m,
        "width_m": floor.width_m,
        "height_m": floor.height_m,
    }


def _floor(row: RowMapping) -> StoredFloor:
    fields = dict(row)
    return StoredFloor(floor_id=fields.pop("id"), **fields)
