"""What placing the scans of a walk by smoothing is worth: waypoints left out, and what maps err."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.core.fingerprint.leaving_out import single_fix
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query, first_of
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.survey import walk_fingerprints
from app.core.fusion.survey_walk import SurveyWalkParams, smoothed_walk, straight_walk
from app.core.motion.walks import strides_of
from app.core.params import MatchParams, StepParams
from app.core.site import SiteModel
from app.core.survey import SurveyWalk
from app.core.types import BleScan, FloatArray, WifiScan
from app.formats.ms2020 import floor_folder_of, fold_of, read_trace, trace_id_of
from app.formats.ms2020_site import BuildingFolder
from app.services.building_import import floor_id_of, site_id_of
from app.services.evaluation import ms2020
from app.services.evaluation.figures import Figures, error_figures
from app.services.evaluation.parallel import on_all_cores
from app.services.evaluation.walks import walk_figures
from app.services.radio_map_building import BuildOptions, Placing, built_map

PROTOCOL = (
    "folds 1 to 3 in turn asked against a map of the other two, fold 0 nowhere; truth linear "
    "between all waypoints, as in every figure of this data set. left_out: each inner waypoint of "
    "a walk, told by the walk without it. single: each Wi-Fi scan alone. single_ends: the same "
    "with maps of walks of which only the first and the last waypoint are known. track: profile "
    "best, at 1 Hz"
)

ROTATIONS = tuple(ms2020.Split(fold, frozenset({1, 2, 3} - {fold})) for fold in (1, 2, 3))

Thinned = Callable[[SurveyWalk], SurveyWalk]


def read_walks(building: BuildingFolder) -> list[SurveyWalk]:
    """Return the walks of folds 1 to 3 as surveys, site frame; those without waypoints left out."""
    paths = ms2020.map_paths(building)
    found = on_all_cores(_survey_walk, paths)
    offset = {floor.name: (floor.x0_m, floor.y0_m) for floor in building.floors}
    site_id = site_id_of(building.name)
    walks = []
    for path, walk in zip(paths, found, strict=True):
        if walk is not None:
            waypoints = walk.waypoints + np.array([0.0, *offset[floor_folder_of(path).name]])
            floor_id = floor_id_of(site_id, floor_folder_of(path).name)
            walks.append(replace(walk, floor_id=floor_id, waypoints=waypoints))
    return walks


def _survey_walk(path: Path) -> SurveyWalk | None:
    try:
        trace = read_trace(path)
    except ValueError:
        return None
    scans = tuple(o for o in trace.observations if isinstance(o, WifiScan | BleScan))
    if not len(trace.waypoints) or not scans:
        return None
    strides = strides_of(trace.observations, StepParams())
    return SurveyWalk(trace.trace_id, "", scans, strides, trace.waypoints)


def figures_of(
    building: BuildingFolder, walks: Sequence[SurveyWalk], *, tracks: bool
) -> dict[str, Figures]:
    """Return the figures by way of placing; ``tracks`` takes minutes."""
    figures: dict[str, Figures] = {}
    for placing in Placing:
        maps = _maps(building, walks, placing, lambda walk: walk)
        ends = _maps(building, walks, placing, _ends_only)
        of_placing: dict[str, Figures] = {
            "left_out": error_figures(left_out_errors(walks, placing)),
            "single": error_figures(_single_errors(walks, maps)),
            "single_ends": error_figures(_single_errors(walks, ends)),
        }
        if tracks:
            of_placing["track"] = _track_figures(building, maps)
        figures[placing.value] = of_placing
    return figures


def left_out_errors(walks: Iterable[SurveyWalk], placing: Placing) -> list[float]:
    """Return how far each inner waypoint is from where the walk without it says."""
    errors_m = []
    for walk in walks:
        for i in range(1, len(walk.waypoints) - 1):
            rest = np.delete(walk.waypoints, i, axis=0)
            time_s, x_m, y_m = walk.waypoints[i]
            told = _path(walk.strides, rest, placing)(float(time_s))
            errors_m.append(float(np.hypot(told[0] - x_m, told[1] - y_m)))
    return errors_m


def _path(
    strides: FloatArray, waypoints: FloatArray, placing: Placing
) -> Callable[[float], tuple[float, float]]:
    if placing is Placing.STRAIGHT:
        return straight_walk(waypoints).at
    return smoothed_walk(strides, waypoints, SurveyWalkParams()).at


def _ends_only(walk: SurveyWalk) -> SurveyWalk:
    return replace(walk, waypoints=walk.waypoints[[0, -1]])


def _maps(
    building: BuildingFolder, walks: Sequence[SurveyWalk], placing: Placing, thinned: Thinned
) -> dict[ms2020.Split, SiteModel]:
    """Return the site as each rotation knows it."""
    maps = {}
    for split in ROTATIONS:
        chosen = [thinned(walk) for walk in walks if fold_of(walk.walk) in split.mapped]
        floors = ms2020.site_of(building, None).floors
        built = built_map(chosen, floors, BuildOptions(placing=placing))
        maps[split] = ms2020.site_of(building, built.radio_map)
    return maps


def _single_errors(walks: Sequence[SurveyWalk], maps: dict[ms2020.Split, SiteModel]) -> list[float]:
    errors_m: list[float] = []
    for split, site in maps.items():
        for walk in walks:
            if fold_of(walk.walk) == split.asked and site.radio_map is not None:
                errors_m += _walk_errors(walk, site.radio_map)
    return errors_m


def _walk_errors(walk: SurveyWalk, radio_map: RadioMap) -> list[float]:
    truth = straight_walk(walk.waypoints)
    first_s, last_s = walk.waypoints[0, 0], walk.waypoints[-1, 0]
    scans = walk_fingerprints(
        walk.scans,
        lambda time_s: truth.at(time_s) if first_s <= time_s <= last_s else None,
        0,
        walk.walk,
        (first_of(radio_map.column_by_key), MatchParams()),
    )
    errors_m = []
    for scan in scans:
        matches = match(Query(scan.wifi_dbm, scan.ble_dbm), radio_map, MatchParams())
        if matches is not None:
            fix = single_fix(matches)
            errors_m.append(float(np.hypot(fix.x_m - scan.x_m, fix.y_m - scan.y_m)))
    return errors_m


def _track_figures(building: BuildingFolder, maps: dict[ms2020.Split, SiteModel]) -> Figures:
    tasks = [
        ms2020.Task(path, split, "best", "recorded")
        for split in ROTATIONS
        for floor in building.floors
        for path in floor.traces
        if fold_of(trace_id_of(path)) == split.asked
    ]
    followed = [one for one in ms2020.score_traces(tasks, maps) if not isinstance(one, str)]
    figures = walk_figures([scored.walk for scored in followed])
    return {
        "mean_error_m": figures["mean_error_m"],
        "p95_error_m": figures["p95_error_m"],
        "stored_mean_error_m": figures["smoothed"]["mean_error_m"],
    }
