"""The survey report of a stored radio map: the map asked about itself, over the site's floors."""

from dataclasses import dataclass

import numpy as np
from sqlalchemy import Connection

from app.core.fingerprint.survey_report import ReportParams, SurveyReport, survey_report
from app.core.params import MatchParams
from app.core.types import FloatArray
from app.services.errors import AppError, ErrorCode, found
from app.storage import floors, radio_maps
from app.storage.floors import PlanImage, StoredFloor
from app.storage.radio_maps import StoredRadioMap


@dataclass(frozen=True, slots=True, eq=False)
class ReportedMap:
    """A report with what is needed to read it: floors in the order of its indexes."""

    radio_map: StoredRadioMap
    floors: tuple[StoredFloor, ...]
    plans: tuple[PlanImage | None, ...]
    report: SurveyReport


def report_of(connection: Connection, radio_map_id: str) -> ReportedMap:
    """Return the report of a radio map.

    Raises
    ------
    AppError
        If there is no such map, none of its floors is left, or nobody surveyed any of it.
    """
    stored = found(radio_maps.get_radio_map(connection, radio_map_id), "radio map", radio_map_id)
    radio_map = found(
        radio_maps.load_radio_map(connection, radio_map_id), "radio map", radio_map_id
    )
    of_site = floors.floors_of_site(connection, stored.site_id)
    params = ReportParams()
    places = [_places(connection, floor, params.cell_m) for floor in of_site]
    try:
        fitted = radio_map.with_floors([floor.floor_id for floor in of_site])
        report = survey_report(fitted, places, MatchParams(), params)
    except ValueError as error:
        raise AppError(ErrorCode.CONFLICT, str(error)) from error
    plans = tuple(floors.get_plan(connection, floor.floor_id) for floor in of_site)
    return ReportedMap(stored, tuple(of_site), plans, report)


def _places(connection: Connection, floor: StoredFloor, cell_m: float) -> FloatArray:
    """Return a grid of where people walk; of a floor without a map, all of its plan."""
    walkable = floors.get_walkable(connection, floor.floor_id)
    if walkable is not None:
        return walkable.cells(cell_m)
    x_m = np.arange(floor.x0_m + cell_m / 2.0, floor.x0_m + floor.width_m, cell_m)
    y_m = np.arange(floor.y0_m + cell_m / 2.0, floor.y0_m + floor.height_m, cell_m)
    return np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)
