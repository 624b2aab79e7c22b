"""Real walks: the engine on held-out traces of a building of the Indoor Location Competition 2.0.

The engine is fed through ``advance`` with what phones would post, second by second, and asked at
the end of each: the same answers as `pharos replay` gets over HTTP.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from app.core.engine import SessionState, advance, finish, smoothed, start
from app.core.evaluate import Answer, Place, ScoredSecond, hold_last, recorded_seconds, score
from app.core.fingerprint.radio_map import RadioMap
from app.core.georeference import fit_georeference
from app.core.params import Params
from app.core.site import Floor, SiteModel
from app.core.types import Observation, Output, TrackPoint, WifiScan
from app.formats.floor_map import parse_floor_map
from app.formats.ms2020 import Trace, fold_of, read_trace, trace_id_of, truth_at
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.building_import import floor_id_of, radio_map_of, site_id_of
from app.services.errors import AppError, ErrorCode
from app.services.evaluation.figures import Figures
from app.services.evaluation.parallel import on_all_cores
from app.services.site import PROFILES

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
    """One trace to be walked through with one profile."""

    path: Path
    split: Split
    profile: str


@dataclass(frozen=True, slots=True)
class ScoredWalk:
    """One trace as the engine answered it.

    ``smoothed`` are the same seconds of the track that is stored when all is known;
    ``scans_right`` of ``scans`` are on the right floor when each Wi-Fi scan is taken alone.
    """

    trace_id: str
    floor_id: str
    seconds: tuple[ScoredSecond, ...]
    smoothed: tuple[ScoredSecond, ...]
    scans: int
    scans_right: int
    observations: int
    cpu_s: float


def read_walks(building: BuildingFolder) -> Iterator[SurveyWalk | str]:
    """Read every trace that a map may be made of; in words why one cannot be used."""
    return on_all_cores(survey_walk_or_reason, map_paths(building))


def map_paths(building: BuildingFolder) -> list[Path]:
    """Return the traces that are in any map."""
    mapped = TEST.mapped | TUNING.mapped
    every = (path for floor in building.floors for path in floor.traces)
    return [path for path in every if fold_of(trace_id_of(path)) in mapped]


def tasks_of(building: BuildingFolder, profiles: Iterable[str]) -> list[Task]:
    """Return what there is to be walked through, the asked traces of every split."""
    paths = [path for floor in building.floors for path in floor.traces]
    tasks = [
        Task(path, split, profile)
        for profile in profiles
        for split in SPLITS
        for path in paths
        if fold_of(trace_id_of(path)) == split.asked
    ]
    if not any(task.split == TEST for task in tasks):
        detail = "there is no trace of fold 0 in it: nothing to test with"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    return tasks


def sites_of(
    building: BuildingFolder, walks: Sequence[SurveyWalk], map_share: float
) -> dict[Split, SiteModel]:
    """Return the site as each split knows it, its map made as the import makes it."""
    site_id = site_id_of(building.name)
    sites: dict[Split, SiteModel] = {}
    for split in SPLITS:
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


def site_of(building: BuildingFolder, radio_map: RadioMap) -> SiteModel:
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


def score_walks(tasks: Sequence[Task], sites: dict[Split, SiteModel]) -> Iterator[ScoredWalk]:
    """Walk through every task, on all cores, in order."""
    return on_all_cores(_score_task, tasks, _begin, (sites, tasks[0]))


_sites: dict[Split, SiteModel] = {}


def _begin(sites: dict[Split, SiteModel], first: Task) -> None:
    _sites.update(sites)
    # Compiled code is loaded before anything is timed.
    _score_task(first)


def _score_task(task: Task) -> ScoredWalk:
    return score_walk(read_trace(task.path), _sites[task.split], PROFILES[task.profile])


def score_walk(trace: Trace, site: SiteModel, params: Params) -> ScoredWalk:
    """Fold a trace and ask at every whole second, as phones are answered."""
    (floor,) = (floor for floor in site.floors if floor.name == trace.floor_name)
    state, cpu_s = start(), 0.0
    truth: list[tuple[float, Place]] = []
    answers: list[Answer | None] = []
    scans: list[str] = []
    for second in recorded_seconds(trace.observations):
        scans += _floors_of_scans(state, second.observations, site, params)
        before_s = process_time()
        state, answer = _answered(state, second.observations, site, params)
        cpu_s += process_time() - before_s
        xy_m = truth_at(trace.waypoints, second.end_s)
        if xy_m is not None and second.is_scored:
            place = Place(floor.floor_id, xy_m[0] + floor.x0_m, xy_m[1] + floor.y0_m)
            truth.append((second.end_s, place))
            answers.append(answer)
    track = {point.time_s: point for point in smoothed(trace.observations, site, params)}
    stored = [_answer(track.get(time_s)) for time_s, _ in truth]
    return ScoredWalk(
        trace_id=trace.trace_id,
        floor_id=floor.floor_id,
        seconds=tuple(hold_last(truth, answers)),
        smoothed=tuple(hold_last(truth, stored)),
        scans=len(scans),
        scans_right=scans.count(floor.floor_id),
        observations=len(trace.observations),
        cpu_s=cpu_s,
    )


def _answered(
    state: SessionState, observations: Sequence[Observation], site: SiteModel, params: Params
) -> tuple[SessionState, Answer | None]:
    """Return what a batch is answered; nobody asks in a second without one."""
    for observation in observations:
        state, _ = advance(state, observation, site, params)
    return state, _answer(finish(state, site, params)[-1] if observations else None)


def _answer(output: Output | None) -> Answer | None:
    if not isinstance(output, TrackPoint):
        return None
    return Answer(output.floor_id, output.x_m, output.y_m, output.radius95_m)


def _floors_of_scans(
    state: SessionState, observations: Iterable[Observation], site: SiteModel, params: Params
) -> Iterator[str]:
    """Yield the floor that each Wi-Fi scan tells by itself, with the beacons heard before."""
    for observation in observations:
        if isinstance(observation, WifiScan):
            alone, _ = advance(replace(start(), heard=state.heard), observation, site, params)
            if alone.floor_belief is not None:
                yield site.floors[int(np.argmax(alone.floor_belief))].floor_id


def figures_of(walks: Sequence[tuple[Task, ScoredWalk]], profile: str) -> Figures:
    """Return the figures of one profile: its test traces, and the mean error of the tuning ones."""
    of_profile = [(task, walk) for task, walk in walks if task.profile == profile]
    tested = [walk for task, walk in of_profile if task.split == TEST]
    tuned = [walk for task, walk in of_profile if task.split == TUNING]
    scored = score(second for walk in tested for second in walk.seconds)
    stored = score(second for walk in tested for second in walk.smoothed)
    return {
        "traces": len(tested),
        "samples": scored.samples,
        "tuning_mean_error_m": score(s for walk in tuned for s in walk.seconds).mean_error_m,
        "mean_error_m": scored.mean_error_m,
        "median_error_m": scored.median_error_m,
        "p75_error_m": scored.p75_error_m,
        "p95_error_m": scored.p95_error_m,
        "floor_accuracy": scored.floor_right_share,
        "floor_accuracy_per_scan": _share(tested, lambda w: w.scans_right, lambda w: w.scans),
        "coverage95": scored.coverage95_share,
        "mean_radius95_m": scored.mean_radius95_m,
        "coverage95_by_decile": scored.coverage95_share_by_decile,
        "no_fix_share": scored.no_fix_share,
        "cpu_us_per_observation": 1e6 * _share(tested, lambda w: w.cpu_s, lambda w: w.observations),
        "smoothed": {"mean_error_m": stored.mean_error_m, "p95_error_m": stored.p95_error_m},
    }


def _share(
    walks: Iterable[ScoredWalk],
    part: Callable[[ScoredWalk], float],
    whole: Callable[[ScoredWalk], float],
) -> float:
    pairs = np.array([(part(walk), whole(walk)) for walk in walks], dtype=np.float64)
    parts, wholes = pairs.reshape(-1, 2).sum(axis=0)
    return float(parts / wholes) if wholes else float("nan")
