"""Sites and floors: edits, and the snapshots of them that live sessions fold with."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from sqlalchemy import Connection

from app.core.engine import PROFILES, prepare
from app.core.fingerprint.radio_map import RadioMap
from app.core.georeference import ControlPoint, Georeference, fit_georeference
from app.core.params import Params
from app.core.site import Floor, SiteModel
from app.formats.floor_map import FloorMapError, parse_floor_map
from app.services.errors import AppError, ErrorCode, FieldError, found
from app.services.writing import SeenVersions, check_seen, write
from app.storage import ageing, floors, radio_maps, sites
from app.storage.beacons import anchors_of_site, beacon_ids_by_key
from app.storage.database import Database
from app.storage.floors import PlanImage, StoredFloor
from app.storage.sites import StoredSite

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedMap:
    """The radio map that a site is matched with, and what it is made of.

    Attributes
    ----------
    made_of
        Id of the stored map, transmitters left out, floors of the site.
    radio_map
        None: it is of no floor of the site.
    """

    made_of: tuple[str, frozenset[str], tuple[str, ...]]
    radio_map: RadioMap | None


class SiteDirectory:
    """The current snapshot of every site, replaced as a whole when its model version changed."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._sites: dict[str, StoredSite] = {}
        self._models: dict[str, SiteModel] = {}
        # What the engine derives of a radio map takes tenths of a second and over ten megabytes a
        # large floor, and is remembered by map: an edit of a wall must not make it anew.
        self._matched: dict[str, MatchedMap] = {}
        self._georeferences: dict[str, Georeference] = {}
        self._beacon_ids: dict[str, dict[str, str]] = {}
        self._refreshing = asyncio.Lock()

    def current(self, site_id: str) -> SiteModel | None:
        """Return the site as it is now, None if there is no such site."""
        return self._models.get(site_id)

    def site_ids(self) -> tuple[str, ...]:
        """Return the ids of all sites."""
        return tuple(self._models)

    def default_profile(self, site_id: str) -> str:
        """Return the profile of sessions at a site that name none."""
        return self._sites[site_id].default_profile

    def grows_map(self, site_id: str) -> bool:
        """Return whether sessions at a site are kept aside for its radio map to grow by."""
        return self._sites[site_id].grow_map

    def georeference(self, site_id: str) -> Georeference | None:
        """Return where the site lies on the globe, None if nobody has said."""
        return self._georeferences.get(site_id)

    def beacon_ids_by_key(self, site_id: str) -> Mapping[str, str]:
        """Return the ids of a site's registered beacons by each of their keys."""
        return self._beacon_ids.get(site_id, {})

    def params(self, site_id: str, profile: str) -> Params:
        """Return the parameters of a profile; KeyError if there is none of this name."""
        _ = site_id
        return PROFILES[profile].params

    async def refresh(self) -> None:
        """Load what was changed since the last time, by this process or another one."""
        async with self._refreshing:
            stored = {s.site_id: s for s in await self._database.read(sites.all_sites)}
            models: dict[str, SiteModel] = {}
            matched: dict[str, MatchedMap] = {}
            beacon_ids: dict[str, dict[str, str]] = {}
            for site_id, site in stored.items():
                model, ids = self._models.get(site_id), self._beacon_ids.get(site_id, {})
                map_then = self._matched.get(site_id)
                if model is None or model.version != site.model_version:
                    load = partial(_loaded, site_id=site_id, known=map_then)
                    model, map_then, ids = await self._database.read(load)
                    if model is not None:
                        await asyncio.to_thread(
                            prepare, model, PROFILES[site.default_profile].params
                        )
                # A site may be gone by the time its model is read.
                if model is not None:
                    models[site_id], beacon_ids[site_id] = model, ids
                    if map_then is not None:
                        matched[site_id] = map_then
            self._sites, self._models, self._beacon_ids = stored, models, beacon_ids
            self._matched = matched
            self._georeferences = {
                site_id: georeference
                for site_id, site in stored.items()
                if (georeference := stored_georeference(site)) is not None
            }


def _loaded(
    connection: Connection, site_id: str, known: MatchedMap | None
) -> tuple[SiteModel | None, MatchedMap | None, dict[str, str]]:
    model, matched = _model_of(connection, site_id, known)
    return model, matched, beacon_ids_by_key(connection, site_id)


def control_points(stored: list[dict[str, float]]) -> list[ControlPoint]:
    """Return the control points of a georeference as stored."""
    return [ControlPoint(p["x"], p["y"], p["lat"], p["lon"]) for p in stored]


def load_site_model(connection: Connection, site_id: str) -> SiteModel | None:
    """Return the snapshot of a site as stored now, None if there is no such site."""
    return _model_of(connection, site_id, None)[0]


def _model_of(
    connection: Connection, site_id: str, known: MatchedMap | None
) -> tuple[SiteModel | None, MatchedMap | None]:
    site = sites.get_site(connection, site_id)
    if site is None:
        return None, None
    stored = floors.floors_of_site(connection, site_id)
    georeference = stored_georeference(site)
    floor_ids = tuple(floor.floor_id for floor in stored)
    matched = _matched_map(connection, site_id, floor_ids, known)
    model = SiteModel(
        site_id=site_id,
        version=site.model_version,
        floors=tuple(_floor(connection, floor) for floor in stored),
        anchors=anchors_of_site(connection, site_id),
        radio_map=None if matched is None else matched.radio_map,
        x_axis_from_east_rad=georeference.x_axis_from_east_rad if georeference else 0.0,
    )
    return model, matched


def _matched_map(
    connection: Connection, site_id: str, floor_ids: tuple[str, ...], known: MatchedMap | None
) -> MatchedMap | None:
    """Return what a site is matched with: the one ``known``, unless it is of something else now."""
    active = radio_maps.list_radio_maps(connection, site_id=site_id, active=True, limit=1)
    if not active:
        return None
    radio_map_id, aged = active[0].radio_map_id, ageing.quarantined_of_active(connection, site_id)
    made_of = radio_map_id, aged, floor_ids
    if known is not None and known.made_of == made_of:
        return known
    whole = radio_maps.load_radio_map(connection, radio_map_id)
    if whole is None:
        return None
    return MatchedMap(made_of, fitted_map(whole.without_transmitters(aged), floor_ids))


def stored_georeference(site: StoredSite) -> Georeference | None:
    """Return where a stored site lies on the globe, None if nobody has said."""
    if site.georeference is None:
        return None
    return fit_georeference(control_points(site.georeference))


def _floor(connection: Connection, stored: StoredFloor) -> Floor:
    document = floors.get_map(connection, stored.floor_id)
    return Floor(
        floor_id=stored.floor_id,
        name=stored.name,
        building=stored.building,
        ordinal=stored.ordinal,
        x0_m=stored.x0_m,
        y0_m=stored.y0_m,
        width_m=stored.width_m,
        height_m=stored.height_m,
        walkable=floors.get_walkable(connection, stored.floor_id),
        walls=() if document is None else parse_floor_map(document).walls,
    )


def fitted_map(radio_map: RadioMap | None, floor_ids: tuple[str, ...]) -> RadioMap | None:
    """Return the map with the site's floors; one of removed floors only is as good as none."""
    if radio_map is None or not set(radio_map.floor_ids) & set(floor_ids):
        return None
    try:
        return radio_map.with_floors(floor_ids)
    except ValueError as error:
        _LOG.warning("the active radio map is not used: %s", error)
        return None


async def create_site(database: Database, site: StoredSite) -> StoredSite:
    """Add a site."""
    return await write(database, lambda c: sites.insert_site(c, site))


async def edit_site(
    database: Database,
    site_id: str,
    seen: SeenVersions,
    edit: Callable[[StoredSite], StoredSite],
) -> StoredSite:
    """Change a site; ``edit`` gets it as stored."""

    def statement(connection: Connection) -> StoredSite:
        before = _seen_site(connection, site_id, seen)
        edited = edit(before)
        if edited.georeference != before.georeference:
            sites.touch_model(connection, site_id)
        return replace(edited, row_version=sites.update_site(connection, edited))

    return await write(database, statement)


async def delete_site(database: Database, site_id: str, seen: SeenVersions) -> None:
    """Remove a site that has no floors any more; its devices stay."""

    def statement(connection: Connection) -> None:
        _seen_site(connection, site_id, seen)
        if floors.floors_of_site(connection, site_id):
            raise AppError(ErrorCode.IN_USE, f"site {site_id!r} still has floors")
        sites.delete_site(connection, site_id)

    await write(database, statement)


async def create_floor(database: Database, floor: StoredFloor) -> StoredFloor:
    """Add a floor to a site."""

    def statement(connection: Connection) -> StoredFloor:
        found(sites.get_site(connection, floor.site_id), "site", floor.site_id)
        floors.insert_floor(connection, floor)
        sites.touch_model(connection, floor.site_id)
        return floor

    return await write(database, statement)


async def edit_floor(
    database: Database,
    floor_id: str,
    seen: SeenVersions,
    edit: Callable[[StoredFloor], StoredFloor],
) -> StoredFloor:
    """Change a floor's names or frame; ``edit`` gets it as stored."""

    def statement(connection: Connection) -> StoredFloor:
        edited = edit(_seen_floor(connection, floor_id, seen))
        sites.touch_model(connection, edited.site_id)
        return replace(edited, row_version=floors.update_floor(connection, edited))

    return await write(database, statement)


async def delete_floor(database: Database, floor_id: str, seen: SeenVersions) -> None:
    """Remove a floor that has no beacons any more."""

    def statement(connection: Connection) -> None:
        floor = _seen_floor(connection, floor_id, seen)
        if any(a.floor_id == floor_id for a in anchors_of_site(connection, floor.site_id)):
            raise AppError(ErrorCode.IN_USE, f"floor {floor_id!r} still has beacons")
        floors.delete_floor(connection, floor_id)
        sites.touch_model(connection, floor.site_id)

    await write(database, statement)


async def replace_plan(
    database: Database, floor_id: str, seen: SeenVersions, plan: PlanImage | None
) -> None:
    """Replace or remove a floor's picture; coordinates and what the engine sees stay."""

    def statement(connection: Connection) -> None:
        found(floors.get_floor(connection, floor_id), "floor", floor_id)
        stored = floors.get_plan(connection, floor_id)
        if plan is None:
            found(stored, "plan of floor", floor_id)
        check_seen(seen, "" if stored is None else stored.digest)
        floors.set_plan(connection, floor_id, plan)

    await write(database, statement)


async def replace_map(
    database: Database, floor_id: str, seen: SeenVersions, document: dict[str, Any] | None
) -> None:
    """Replace or remove a floor's map, and with it the walkable raster."""
    try:
        await store_map(database, floor_id, seen, document)
    except FloorMapError as error:
        errors = (FieldError(error.pointer, error.detail),)
        detail = "the document is not a floor's map"
        raise AppError(ErrorCode.INVALID_FIELD, detail, errors=errors) from error


async def store_map(
    database: Database, floor_id: str, seen: SeenVersions, document: dict[str, Any] | None
) -> None:
    """Store or remove a floor's map together with what the engine makes of it.

    Raises
    ------
    FloorMapError
        If the document is not a floor's map.
    """
    walkable = None
    if document is not None:
        walkable = await asyncio.to_thread(lambda: parse_floor_map(document).raster())

    def statement(connection: Connection) -> None:
        floor = _seen_floor(connection, floor_id, seen)
        if document is None:
            found(floor.has_map or None, "map of floor", floor_id)
        floors.set_map(connection, floor_id, document, walkable)
        sites.touch_model(connection, floor.site_id)

    await write(database, statement)


def _seen_site(connection: Connection, site_id: str, seen: SeenVersions) -> StoredSite:
    site = found(sites.get_site(connection, site_id), "site", site_id)
    check_seen(seen, site.row_version)
    return site


def _seen_floor(connection: Connection, floor_id: str, seen: SeenVersions) -> StoredFloor:
    floor = found(floors.get_floor(connection, floor_id), "floor", floor_id)
    check_seen(seen, floor.row_version)
    return floor
