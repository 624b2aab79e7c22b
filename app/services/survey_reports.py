"""Survey reports: of a stored radio map, and of the map that one survey alone would make."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from sqlalchemy import Connection

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.leaving_out import fingerprints_of
from app.core.fingerprint.radio_map import RadioMap, joined
from app.core.fingerprint.survey_report import ReportParams, SurveyReport, survey_report
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams
from app.core.types import FloatArray
from app.services.errors import AppError, ErrorCode, found
from app.services.radio_map_building import BuildOptions, built_map
from app.services.radio_map_builds import BuildRequest, load_surveyed
from app.storage import floors, radio_maps, surveys
from app.storage.floors import PlanImage, StoredFloor
from app.storage.radio_maps import StoredRadioMap
from app.storage.surveys import StoredSurvey

MAX_SCANS = 20_000
"""Every scan is compared with all others: twice as many take four times as long, and these take
about two minutes already. A shopping centre's survey has a quarter of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
    """A report with what is needed to read it: floors in the order of its indexes."""

    floors: tuple[StoredFloor, ...]
    plans: tuple[PlanImage | None, ...]
    report: SurveyReport


@dataclass(frozen=True, slots=True, eq=False)
class ReportedMap:
    """The report of a radio map."""

    radio_map: StoredRadioMap
    reported: Reported


class JudgedBy(StrEnum):
    """What the scans of a survey were matched with."""

    OTHER_WALKS = "other_walks"
    ACTIVE_RADIO_MAP = "active_radio_map"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True, eq=False)
class ReportedSurvey:
    """The report of a survey.

    Attributes
    ----------
    radio_map
        The active one, where the survey was judged by it.
    """

    survey: StoredSurvey
    judged_by: JudgedBy
    radio_map: StoredRadioMap | None
    reported: Reported


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
    return ReportedMap(stored, _reported(connection, stored.site_id, radio_map))


def report_of_survey(connection: Connection, survey_id: str) -> ReportedSurvey:
    """Return the report of the radio map that a survey alone would make.

    A survey of one walk cannot be asked about itself: its scans are matched with the active radio
    map instead, walks of its name left out, and the cells are those of both together.

    Raises
    ------
    AppError
        If there is no such survey, or none of it can be placed on the site's floors.
    """
    survey = found(surveys.get_survey(connection, survey_id), "survey", survey_id)
    _check_size(sum(holding.scans + holding.fingerprints for holding in survey.holdings))
    own = _own_map(connection, survey)
    walks = frozenset(own.survey_walks)
    judge = _other_walks_in_use(connection, survey.site_id, walks) if len(walks) == 1 else None
    if judge is None:
        judged_by = JudgedBy.OTHER_WALKS if len(walks) > 1 else JudgedBy.NOTHING
        reported = _reported(connection, survey.site_id, own)
        return ReportedSurvey(survey, judged_by, None, reported)
    active, others = judge
    both = joined(others.with_floors(own.floor_ids), list(fingerprints_of(own)))
    reported = _reported(connection, survey.site_id, both, walks)
    return ReportedSurvey(survey, JudgedBy.ACTIVE_RADIO_MAP, active, reported)


def _own_map(connection: Connection, survey: StoredSurvey) -> RadioMap:
    request = BuildRequest(survey.site_id, (survey.survey_id,))
    surveyed, on_floors = load_surveyed(connection, request)
    try:
        return built_map(surveyed, on_floors, BuildOptions(virtual=False)).radio_map
    except AppError as error:
        detail = f"survey {survey.survey_id!r} makes no fingerprint: none of it can be placed"
        raise AppError(ErrorCode.CONFLICT, detail) from error


def _other_walks_in_use(
    connection: Connection, site_id: str, walks: frozenset[str]
) -> tuple[StoredRadioMap, RadioMap] | None:
    """Return the active radio map without these walks; None if nothing surveyed is left of it."""
    listed = radio_maps.list_radio_maps(connection, site_id=site_id, active=True, limit=1)
    loaded = radio_maps.load_active(connection, site_id)
    if loaded is None or not listed:
        return None
    left = np.array([walk not in walks for walk in loaded.survey_walks], dtype=np.bool_)
    others = loaded.of_rows(left & ~is_virtual(loaded))
    return (listed[0], others) if is_surveyed(others).any() else None


def _reported(
    connection: Connection, site_id: str, radio_map: RadioMap, walks: frozenset[str] | None = None
) -> Reported:
    _check_size(int(~is_virtual(radio_map).sum()))
    of_site = floors.floors_of_site(connection, site_id)
    params = ReportParams()
    places = [_places(connection, floor, params.cell_m) for floor in of_site]
    try:
        fitted = radio_map.with_floors([floor.floor_id for floor in of_site])
        report = survey_report(fitted, places, MatchParams(), params, walks)
    except ValueError as error:
        raise AppError(ErrorCode.CONFLICT, str(error)) from error
    plans = tuple(floors.get_plan(connection, floor.floor_id) for floor in of_site)
    return Reported(tuple(of_site), plans, report)


def _check_size(scans: int) -> None:
    if scans > MAX_SCANS:
        detail = f"a report is made of at most {MAX_SCANS} scans, here are {scans}"
        raise AppError(ErrorCode.CONFLICT, detail)


def _places(connection: Connection, floor: StoredFloor, cell_m: float) -> FloatArray:
    """Return a grid of where people walk; of a floor without a map, all of its plan."""
    walkable = floors.get_walkable(connection, floor.floor_id)
    if walkable is not None:
        return walkable.cells(cell_m)
    x_m = np.arange(floor.x0_m + cell_m / 2.0, floor.x0_m + floor.width_m, cell_m)
    y_m = np.arange(floor.y0_m + cell_m / 2.0, floor.y0_m + floor.height_m, cell_m)
    return np.stack(np.meshgrid(x_m, y_m), axis=-1).reshape(-1, 2)
