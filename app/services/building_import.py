"""A building of surveyed walks becomes a site: floors, plans, maps and the first radio map."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from sqlalchemy import Connection

from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.fingerprint.survey import Place, chosen_keys, walk_fingerprints
from app.core.fingerprint.virtual import VirtualParams, filled
from app.core.params import MatchParams
from app.core.types import FloatArray
from app.formats.floor_map import parse_floor_map
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.formats.ms2020_survey import SurveyWalk
from app.services.errors import AppError, ErrorCode
from app.storage import floors, radio_maps, sites
from app.storage.floors import PlanImage, StoredFloor
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap
from app.storage.sites import StoredSite

# A surveyor stands at the first and the last waypoint for a moment: scans reported this much before
# and after are placed there.
LEAD_S, TRAIL_S = 1.5, 1.0


@dataclass(frozen=True, slots=True)
class SiteImport:
    """A building ready to be stored.

    ``provenance`` says what the radio map was built from.
    """

    name: str
    building: BuildingFolder
    radio_map: RadioMap
    provenance: dict[str, list[int] | int | str]


def site_id_of(name: str) -> str:
    """Return an id made of a name: what ids may hold of it, joined by hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "site"


def radio_map_of(building: BuildingFolder, site_id: str, walks: Sequence[SurveyWalk]) -> RadioMap:
    """Return the radio map of survey walks, the same whatever order they come in.

    Raises
    ------
    AppError
        If no scan of them can be placed.
    """
    position = {floor.name: i for i, floor in enumerate(building.floors)}
    ordered = sorted(walks, key=lambda walk: (position[walk.floor_name], walk.trace_id))
    rule = chosen_keys(scan for walk in ordered for scan in walk.scans), MatchParams()
    fingerprints: list[Fingerprint] = []
    for walk in ordered:
        index = position[walk.floor_name]
        place_at = partial(_surveyed_place, walk.waypoints, building.floors[index])
        fingerprints += walk_fingerprints(walk.scans, place_at, index, walk.trace_id, rule)
    if not fingerprints:
        detail = "no scan of the walks can be placed: there would be no radio map"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    floor_ids = [floor_id_of(site_id, floor.name) for floor in building.floors]
    return _filled(build_radio_map(floor_ids, fingerprints), building)


def _filled(radio_map: RadioMap, building: BuildingFolder) -> RadioMap:
    rasters = [parse_floor_map(floor.map_document).raster() for floor in building.floors]
    return filled(radio_map, rasters, VirtualParams())


def _surveyed_place(waypoints: FloatArray, floor: FloorFolder, time_s: float) -> Place | None:
    time = waypoints[:, 0]
    if not time[0] - LEAD_S <= time_s <= time[-1] + TRAIL_S:
        return None
    x_m = float(np.interp(time_s, time, waypoints[:, 1])) + floor.x0_m
    return x_m, float(np.interp(time_s, time, waypoints[:, 2])) + floor.y0_m


def floor_id_of(site_id: str, floor_name: str) -> str:
    """Return the id of a floor of an imported site."""
    return f"{site_id}-{floor_name}"


def refuse_existing(connection: Connection, site_id: str) -> None:
    """Raise AppError if there is a site of this id."""
    if sites.get_site(connection, site_id) is not None:
        detail = f"there is a site {site_id!r} already; --replace brings it up to date"
        raise AppError(ErrorCode.CONFLICT, detail)


def storing(
    wanted: SiteImport, created_s: float, *, overwrite: bool
) -> Callable[[Connection], StoredRadioMap]:
    """Return the one transaction that stores an import.

    With ``overwrite`` a site of the same id keeps its history and everything the folder does not
    speak of; its floors are brought up to date and the new radio map becomes the active one.
    """
    site_id = site_id_of(wanted.name)
    rasters = {f.name: parse_floor_map(f.map_document).raster() for f in wanted.building.floors}

    def statement(connection: Connection) -> StoredRadioMap:
        if not overwrite:
            refuse_existing(connection, site_id)
        if sites.get_site(connection, site_id) is None:
            sites.insert_site(connection, _site(site_id, wanted, created_s))
        known = {f.floor_id: f for f in floors.floors_of_site(connection, site_id)}
        for folder in wanted.building.floors:
            floor = _stored_floor(site_id, wanted.building.name, folder)
            if floor.floor_id in known:
                version = known[floor.floor_id].row_version
                floors.update_floor(connection, replace(floor, row_version=version))
            else:
                floors.insert_floor(connection, floor)
            floors.set_plan(connection, floor.floor_id, PlanImage("image/png", folder.plan_png))
            floors.set_map(connection, floor.floor_id, folder.map_document, rasters[folder.name])
        origin = RadioMapOrigin("survey walks", created_s, wanted.provenance)
        return radio_maps.save_radio_map(
            connection, site_id, wanted.radio_map, origin, activate=True
        )

    return statement


def _site(site_id: str, wanted: SiteImport, created_s: float) -> StoredSite:
    points = [
        {"x": point.x_m, "y": point.y_m, "lat": point.lat_deg, "lon": point.lon_deg}
        for point in wanted.building.control_points
    ]
    return StoredSite(site_id, wanted.name, created_s, georeference=points)


def _stored_floor(site_id: str, building: str, folder: FloorFolder) -> StoredFloor:
    return StoredFloor(
        floor_id=floor_id_of(site_id, folder.name),
        site_id=site_id,
        name=folder.name,
        ordinal=folder.ordinal,
        width_m=folder.width_m,
        height_m=folder.height_m,
        building=building,
        x0_m=folder.x0_m,
        y0_m=folder.y0_m,
    )
