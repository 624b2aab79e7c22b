"""Real walks: the engine on held-out traces of a building of the Indoor Location Competition."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from app.core.engine import PROFILES
from app.core.evaluate import Place
from app.core.fingerprint.radio_map import RadioMap
from app.core.georeference import fit_georeference
from app.core.params import Params
from app.core.site import Floor, SiteModel
from app.formats.floor_map import parse_floor_map
from app.formats.ms2020 import Trace, fold_of, read_trace, trace_id_of, truth_at
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.building_import import floor_id_of, radio_map_of, site_id_of
from app.services.errors import AppError, ErrorCode
from app.services.evaluation.figures import Figures
from app.services.evaluation.parallel import on_all_cores
from app.services.evaluation.phones import PHONES
from app.services.evaluation.walks import FollowedWalk, follow, walk_figures

PROTOCOL = (
    "fold = int(md5(trace id)[:8], 16) % 4; traces of fold 0 against a map of the walks of folds 1 "
    "to 3; tuning: traces of fold 1 against a map of folds 2 and 3; scored at 1 Hz from the first "
    "scan on, causal, truth linear between waypoints, errors 2-D and pooled over all seconds; a "
    "second without a fix holds the last position; wrong floors stay in"
)


@dataclass(frozen=True, slots=True)
class Split:
    """Which folds are asked, and which ones the map is made of."""

    asked: int
    mapped: frozenset[int]


TEST = Split(0, frozenset({1, 2, 3}))
TUNING = Split(1, frozenset({2, 3}))
SPLITS = (TUNING, TEST)


class Task(NamedTuple):
    """One trace to be walked through with one profile, as one kind of phone posts it."""

    path: Path
    split: Split
    profile: str
    phone: str


@dataclass(frozen=True, slots=True)
class ScoredTrace:
    """One trace, followed."""

    trace_id: str
    walk: FollowedWalk


def read_walks(building: BuildingFolder) -> Iterator[SurveyWalk | str]:
    """Read every trace that a map may be made of; in words why one cannot be used."""
    return on_all_cores(survey_walk_or_reason, map_paths(building))


def map_paths(building: BuildingFolder) -> list[Path]:
    """Return the traces that are in any map."""
    mapped = TEST.mapped | TUNING.mapped
    every = (path for floor in building.floors for path in floor.traces)
    return [path for path in every if fold_of(trace_id_of(path)) in mapped]


def tasks_of(
    building: BuildingFolder, profiles: Iterable[str], phone: str = "recorded"
) -> list[Task]:
    """Return what there is to be walked through: the asked traces of every split with a map."""
    paths = [path for floor in building.floors for path in floor.traces]
    folds = [fold_of(trace_id_of(path)) for path in paths]
    tasks = [
        Task(path, split, profile, phone)
        for profile in profiles
        for split in SPLITS
        for path, fold in zip(paths, folds, strict=True)
        if fold == split.asked and not split.mapped.isdisjoint(folds)
    ]
    if not any(task.split == TEST for task in tasks):
        detail = "it lacks traces of fold 0 to test with, or any of folds 1 to 3 for the map"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    return tasks


def sites_of(
    building: BuildingFolder,
    walks: Sequence[SurveyWalk],
    splits: Iterable[Split],
    map_share: float,
) -> dict[Split, SiteModel]:
    """Return the site as each split knows it, its map made as the import makes it."""
    site_id = site_id_of(building.name)
    sites: dict[Split, SiteModel] = {}
    for split in splits:
        chosen = [walk for walk in walks if fold_of(walk.trace_id) in split.mapped]
        chosen = smallest_md5_share(chosen, map_share)
        sites[split] = site_of(building, radio_map_of(building, site_id, chosen))
    return sites


def smallest_md5_share(walks: Iterable[SurveyWalk], share: float) -> list[SurveyWalk]:
    """Return this share of each floor's walks, at least one: those with the smallest md5."""
    by_floor: dict[str, list[SurveyWalk]] = {}
    for walk in sorted(walks, key=lambda walk: _md5(walk.trace_id)):
        by_floor.setdefault(walk.floor_name, []).append(walk)
    return [
        walk
        for of_floor in by_floor.values()
        for walk in of_floor[: max(round(share * len(of_floor)), 1)]
    ]


def _md5(trace_id: str) -> str:
    return hashlib.md5(trace_id.encode(), usedforsecurity=False).hexdigest()


def site_of(building: BuildingFolder, radio_map: RadioMap | None) -> SiteModel:
    """Return the building as the server would fold with it."""
    site_id = site_id_of(building.name)
    georeference = fit_georeference(building.control_points)
    return SiteModel(
        site_id=site_id,
        version=1,
        floors=tuple(_floor(building, site_id, folder) for folder in building.floors),
        radio_map=radio_map,
        x_axis_from_east_rad=georeference.x_axis_from_east_rad,
    )


def _floor(building: BuildingFolder, site_id: str, folder: FloorFolder) -> Floor:
    floor_map = parse_floor_map(folder.map_document)
    return Floor(
        floor_id=floor_id_of(site_id, folder.name),
        name=folder.name,
        building=building.name,
        ordinal=folder.ordinal,
        x0_m=folder.x0_m,
        y0_m=folder.y0_m,
        width_m=folder.width_m,
        height_m=folder.height_m,
        walkable=floor_map.raster(),
        walls=floor_map.walls,
    )


def score_traces(
    tasks: Sequence[Task], sites: dict[Split, SiteModel]
) -> Iterator[ScoredTrace | str]:
    """Follow the trace of every task, on all cores, in order; in words why one cannot be used."""
    return on_all_cores(_score_task, tasks, _begin, (sites, tasks[0]))


_sites: dict[Split, SiteModel] = {}


def _begin(sites: dict[Split, SiteModel], first: Task) -> None:
    _sites.update(sites)
    # Compiled code is loaded before anything is timed.
    _score_task(first)


def _score_task(task: Task) -> ScoredTrace | str:
    params = PROFILES[task.profile].params
    try:
        trace = read_trace(task.path)
    except (ValueError, OSError) as error:
        return str(error)
    if not len(trace.waypoints):
        return "no waypoint in it"
    posted = replace(trace, observations=PHONES[task.phone](trace.observations))
    return score_trace(posted, _sites[task.split], params)


def score_trace(trace: Trace, site: SiteModel, params: Params) -> ScoredTrace:
    """Follow one trace."""
    (floor,) = (floor for floor in site.floors if floor.name == trace.floor_name)

    def place_at(time_s: float) -> Place | None:
        xy_m = truth_at(trace.waypoints, time_s)
        if xy_m is None:
            return None
        return Place(floor.floor_id, xy_m[0] + floor.x0_m, xy_m[1] + floor.y0_m)

    return ScoredTrace(trace.trace_id, follow(trace.observations, place_at, site, params))


def figures_of(scored: Sequence[tuple[Task, ScoredTrace]], profile: str) -> Figures:
    """Return the figures of one profile: its test traces, and the mean error of the tuning ones."""
    tested, tuned = (
        [trace.walk for task, trace in scored if (task.profile, task.split) == (profile, split)]
        for split in (TEST, TUNING)
    )
    figures = walk_figures(tested)
    return {
        "traces": len(tested),
        "samples": figures["samples"],
        "tuning_mean_error_m": walk_figures(tuned)["mean_error_m"],
        **figures,
    }
