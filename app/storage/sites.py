"""Sites as stored."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, delete, insert, select, update

from app.storage.rows import unique, update_row
from app.storage.tables import SITES


@dataclass(frozen=True, slots=True)
class StoredSite:
    """One site.

    Attributes
    ----------
    grow_map
        Whether finished sessions are kept aside for the radio map to grow by.
    georeference
        Control points as JSON (`app.core.georeference`), None while the site is not on the globe.
    model_version
        Counts the edits of all that the engine sees: floors, maps, beacons, the active radio map,
        the georeference.
    row_version
        Counts the edits of this row: its ETag.
    """

    site_id: str
    name: str
    created_s: float
    retention_days: float | None = None
    default_profile: str = "best"
    georeference: list[dict[str, float]] | None = None
    grow_map: bool = False
    model_version: int = 1
    row_version: int = 1


def list_sites(
    connection: Connection, *, site_id: str | None = None, after: str | None, limit: int
) -> list[StoredSite]:
    """Return up to ``limit + 1`` sites by id; with ``site_id`` only that one."""
    query = select(SITES).order_by(SITES.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(SITES.c.id == site_id)
    if after is not None:
        query = query.where(SITES.c.id > after)
    return [_site(row) for row in connection.execute(query).mappings()]


def get_site(connection: Connection, site_id: str) -> StoredSite | None:
    """Return a site, None if there is none of this id."""
    row = connection.execute(select(SITES).where(SITES.c.id == site_id)).mappings().one_or_none()
    return None if row is None else _site(row)


def insert_site(connection: Connection, site: StoredSite) -> StoredSite:
    """Store a new site."""
    with unique(f"site {site.site_id!r}"):
        connection.execute(
            insert(SITES).values(id=site.site_id, created_s=site.created_s, **_editable(site))
        )
    return site


def update_site(connection: Connection, site: StoredSite) -> int:
    """Store the edited fields of a site read as ``row_version``; return the new version."""
    return update_row(connection, SITES, site.site_id, site.row_version, _editable(site))


def delete_site(connection: Connection, site_id: str) -> None:
    """Remove a site with everything that was recorded in it."""
    connection.execute(delete(SITES).where(SITES.c.id == site_id))


def touch_model(connection: Connection, site_id: str) -> None:
    """Say that something the engine sees of the site was changed in this transaction."""
    connection.execute(
        update(SITES).where(SITES.c.id == site_id).values(model_version=SITES.c.model_version + 1)
    )


def all_sites(connection: Connection) -> list[StoredSite]:
    """Return every site."""
    return [_site(row) for row in connection.execute(select(SITES)).mappings()]


def _editable(site: StoredSite) -> dict[str, Any]:
    return {
        "name": site.name,
        "retention_days": site.retention_days,
        "default_profile": site.default_profile,
        "georeference": site.georeference,
        "grow_map": site.grow_map,
    }


def _site(row: RowMapping) -> StoredSite:
    fields = dict(row)
    return StoredSite(site_id=fields.pop("id"), **fields)
