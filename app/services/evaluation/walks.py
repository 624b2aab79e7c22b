"""Recorded or simulated walks, followed by the engine and scored second by second.

The engine is fed through ``advance`` with what phones would post and asked at the end of each
second: the same answers as `pharos replay` gets over HTTP.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import process_time
from typing import TypeAlias

import numpy as np

from app.core.engine import SessionState, advance, finish, smoothed, start
from app.core.evaluate import Answer, Place, ScoredSecond, hold_last, recorded_seconds, score
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import Observation, Output, TrackPoint, WifiScan
from app.services.evaluation.figures import Figures

TruthAt: TypeAlias = Callable[[float], Place | None]
"""Where the phone truly was at a time; None where that is not known."""


@dataclass(frozen=True, slots=True)
class FollowedWalk:
    """One walk as the engine answered it.

    ``smoothed`` are the same seconds of the track that is stored when all is known;
    ``scans_right`` of ``scans`` are on the right floor when each Wi-Fi scan is taken alone.
    """

    seconds: tuple[ScoredSecond, ...]
    smoothed: tuple[ScoredSecond, ...]
    scans: int
    scans_right: int
    observations: int
    cpu_s: float


def follow(
    observations: Sequence[Observation], truth_at: TruthAt, site: SiteModel, params: Params
) -> FollowedWalk:
    """Fold observations, in the order of the fold, and ask at every whole second."""
    state, cpu_s = start(), 0.0
    truth: list[tuple[float, Place]] = []
    answers: list[Answer | None] = []
    scans: list[bool] = []
    for second in recorded_seconds(observations):
        scans += _floors_right(state, second.observations, truth_at, (site, params))
        before_s = process_time()
        state, answer = _answered(state, second.observations, site, params)
        cpu_s += process_time() - before_s
        place = truth_at(second.end_s)
        if place is not None and second.is_scored:
            truth.append((second.end_s, place))
            answers.append(answer)
    track = {point.time_s: point for point in smoothed(observations, site, params)}
    stored = [_answer(track.get(time_s)) for time_s, _ in truth]
    return FollowedWalk(
        seconds=tuple(hold_last(truth, answers)),
        smoothed=tuple(hold_last(truth, stored)),
        scans=len(scans),
        scans_right=sum(scans),
        observations=len(observations),
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


def _floors_right(
    state: SessionState,
    observations: Sequence[Observation],
    truth_at: TruthAt,
    world: tuple[SiteModel, Params],
) -> Iterator[bool]:
    """Tell of each Wi-Fi scan alone, with the beacons heard before, if its floor is the right one.

    Scans that nothing is known of, or that tell nothing, are passed over.
    """
    site, params = world
    for observation in observations:
        place = truth_at(observation.time_s)
        if isinstance(observation, WifiScan) and place is not None:
            alone, _ = advance(replace(start(), heard=state.heard), observation, site, params)
            if alone.floor_belief is not None:
                floor = site.floors[int(np.argmax(alone.floor_belief))]
                yield floor.floor_id == place.floor_id


def walk_figures(walks: Sequence[FollowedWalk]) -> Figures:
    """Return the figures of walks, pooled over all their seconds."""
    scored = score(second for walk in walks for second in walk.seconds)
    stored = score(second for walk in walks for second in walk.smoothed)
    right, scans = sum(w.scans_right for w in walks), sum(w.scans for w in walks)
    cpu_s, observations = sum(w.cpu_s for w in walks), sum(w.observations for w in walks)
    return {
        "samples": scored.samples,
        "mean_error_m": scored.mean_error_m,
        "median_error_m": scored.median_error_m,
        "p75_error_m": scored.p75_error_m,
        "p95_error_m": scored.p95_error_m,
        "floor_accuracy": scored.floor_right_share,
        "floor_accuracy_per_scan": right / scans if scans else None,
        "coverage95": scored.coverage95_share,
        "mean_radius95_m": scored.mean_radius95_m,
        "coverage95_by_decile": scored.coverage95_share_by_decile,
        "no_fix_share": scored.no_fix_share,
        "lost_share": scored.lost_share,
        "cpu_us_per_observation": 1e6 * cpu_s / observations if observations else None,
        "smoothed": {"mean_error_m": stored.mean_error_m, "p95_error_m": stored.p95_error_m},
    }
