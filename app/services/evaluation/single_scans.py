"""Single Wi-Fi scans of held-out walks, each with where it was heard: nothing joins them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.core.fingerprint.leaving_out import single_fix
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query, first_of
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.survey import walk_fingerprints
from app.core.params import MatchParams
from app.core.types import FloatArray
from app.formats.ms2020 import fold_of, trace_id_of, truth_at
from app.formats.ms2020_site import BuildingFolder
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.building_import import radio_map_of, site_id_of
from app.services.errors import AppError, ErrorCode
from app.services.evaluation.ms2020 import TEST, Split
from app.services.evaluation.parallel import on_all_cores

TUNING_SPLITS = (
    Split(1, frozenset({2, 3})),
    Split(2, frozenset({1, 3})),
    Split(3, frozenset({1, 2})),
)
"""What parameters are chosen with; ``TEST`` is for the figures alone."""

SPLITS = (*TUNING_SPLITS, TEST)

PROTOCOL = (
    "fold = int(md5(trace id)[:8], 16) % 4; test: scans of fold 0 against a map of folds 1 to 3; "
    "tuning: scans of each of folds 1 to 3 against a map of the other two; every Wi-Fi scan is "
    "matched alone, with the beacons of the last 3 s; truth linear between waypoints"
)


@dataclass(frozen=True, slots=True)
class PlacedQuery:
    """What was heard, where, and on which walk."""

    walk: str
    floor_index: int
    x_m: float
    y_m: float
    query: Query


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """A map and the scans that are asked of it."""

    radio_map: RadioMap
    scans: tuple[PlacedQuery, ...]


def trace_paths(building: BuildingFolder) -> list[Path]:
    """Return every trace of a building; AppError if some fold has none."""
    paths = [path for floor in building.floors for path in floor.traces]
    if len({fold_of(trace_id_of(path)) for path in paths}) < len(SPLITS):
        raise AppError(ErrorCode.INVALID_FIELD, "it lacks traces of at least one of folds 0 to 3")
    return paths


def read_traces(paths: Sequence[Path]) -> Iterator[SurveyWalk | str]:
    """Read traces on all cores; in words why one cannot be used."""
    return on_all_cores(survey_walk_or_reason, paths)


def held_out(building: BuildingFolder, walks: Sequence[SurveyWalk], split: Split) -> HeldOut:
    """Return the map of a split, made as the import makes it, and the scans asked of it."""
    mapped = [walk for walk in walks if fold_of(walk.trace_id) in split.mapped]
    radio_map = radio_map_of(building, site_id_of(building.name), mapped)
    asked = [walk for walk in walks if fold_of(walk.trace_id) == split.asked]
    scans = [s for walk in asked for s in _placed(building, walk, radio_map)]
    return HeldOut(radio_map, tuple(scans))


def _placed(
    building: BuildingFolder, walk: SurveyWalk, radio_map: RadioMap
) -> Iterator[PlacedQuery]:
    position = {floor.name: i for i, floor in enumerate(building.floors)}[walk.floor_name]
    floor = building.floors[position]

    def place_at(time_s: float) -> tuple[float, float] | None:
        xy_m = truth_at(walk.waypoints, time_s)
        return None if xy_m is None else (xy_m[0] + floor.x0_m, xy_m[1] + floor.y0_m)

    rule = first_of(radio_map.column_by_key), MatchParams()
    for heard in walk_fingerprints(walk.scans, place_at, position, walk.trace_id, rule):
        query = Query(heard.wifi_dbm, heard.ble_dbm)
        yield PlacedQuery(walk.trace_id, heard.floor_index, heard.x_m, heard.y_m, query)


def single_errors_m(scans: Sequence[PlacedQuery], radio_map: RadioMap) -> FloatArray:
    """Return the error (n,) of each scan's single fix on the plane; nan without one."""
    errors_m = np.full(len(scans), np.nan)
    for i, scan in enumerate(scans):
        matches = match(scan.query, radio_map, MatchParams())
        if matches is not None:
            fix = single_fix(matches)
            errors_m[i] = np.hypot(fix.x_m - scan.x_m, fix.y_m - scan.y_m)
    return errors_m
