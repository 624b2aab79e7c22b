"""Reproduction of liu2016: speed and heading blended of Wi-Fi and sensors on 40 m of corridor.

Source: Liu, Jiang, Liu, Chen, "Multi-sensor fusion based indoor real-time and highly accurate
trajectory generation", Computer Science 43(1), 2016.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.core.fusion.blending import BlendedMotion, BlendingParams, accelerated_mps, blended
from app.core.fusion.blending_weights import LabelledEpoch, fit_weights, labelled
from app.core.fusion.constant_velocity import ConstantVelocityParams, begun_at, followed
from app.core.types import FloatArray
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.papers.liu2016_corridor import (
    ALONG_ONLY_M,
    ROUND,
    WIFI_MEAN_ERROR_M,
    WIFI_SIGMA_M,
    CorridorWalk,
    SetUp,
    corridor_walk,
)

PROTOCOL = (
    "40 m of corridor at 1.2 m/s, one fix a second with independent plane errors of mean 2.6 m; "
    "the first fix is the mean of three at a stand; an accelerometer whose double integration errs "
    "about as in the paper, a heading with 3 degrees of constant and 3 of white error; "
    "published weights; errors at the fixes after the first, ratios per walk; fitted: weights of "
    "other walks with corners and stops"
)

PUBLISHED_RATIOS = {"blended_ratio": 0.68, "filtered_ratio": 0.60}
PUBLISHED_MEANS_M = {
    "wifi_mean_error_m": WIFI_MEAN_ERROR_M,
    "double_integration_mean_error_m": 2.05,
    "blended_mean_error_m": 1.76,
    "filtered_mean_error_m": 1.54,
}
PUBLISHED_GAIN_POINTS = 26.0
NEAR_M = 3.0

OTHER_SET_UPS = {
    "first_fix_of_one_scan": SetUp(stood_fixes=1),
    "a_fix_every_3_s": SetUp(fix_period_s=3.0),
    "fixes_err_alike_over_2_m": SetUp(alike_m=2.0),
    "fixes_err_along_the_corridor": SetUp(sigmas_m=ALONG_ONLY_M),
}

FILTER = ConstantVelocityParams(
    velocity_walk_mps=0.2,
    place_sigma_m=WIFI_SIGMA_M,
    blended_sigma_mps=0.5,
)
"""A walker at an even pace, and fixes that err as they do here."""

PLANTED = BlendingParams((0.25, 0.35, 0.3), (0.05, 0.1, 0.85))
MARK_SIGMA_M = 0.02
"""How exactly the places of a labelled walk are known."""
# Calibration walks are other ones than those that are measured.
CALIBRATION_SEED, CALIBRATION_WALKS, ROUNDS = 1_000_000, 3, 3


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return the paper's table and ratios, and what becomes of them elsewhere."""
    published = BlendingParams()
    return {
        **_table(seeds, SetUp(), published),
        "fitted": _ratios(seeds, SetUp(), _fitted(published)),
        "planted_weights_worst_error": over_seeds([_worst_error(seed) for seed in seeds]),
        "other_set_ups": {
            name: _ratios(seeds, set_up, published) for name, set_up in OTHER_SET_UPS.items()
        },
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Followed:
    """One walk as the system follows it: blended, and filtered after that, (n, 2) each."""

    motions: tuple[BlendedMotion, ...]
    filtered: FloatArray

    @property
    def blended(self) -> FloatArray:
        return np.array([(motion.x_m, motion.y_m) for motion in self.motions])


def _follow(walk: CorridorWalk, params: BlendingParams) -> _Followed:
    first = walk.fixes[0]
    motions = [BlendedMotion(first.time_s, first.x_m, first.y_m)]
    track = begun_at(np.array([first.x_m, first.y_m]), WIFI_SIGMA_M, FILTER.begin_sigma_mps)
    filtered = [track.mean[:2]]
    for fix, sensed in zip(walk.fixes[1:], walk.sensed, strict=True):
        seconds = fix.time_s - motions[-1].time_s
        motions.append(blended(motions[-1], fix, sensed, params))
        place = np.array([fix.x_m, fix.y_m])
        track = followed(track, seconds, motions[-1].velocity_mps, place, FILTER)
        filtered.append(track.mean[:2])
    return _Followed(tuple(motions), np.array(filtered))


def _integrated_twice(walk: CorridorWalk) -> FloatArray:
    """Return the places that the accelerometer and the heading tell alone, from the first fix."""
    speed_mps = 0.0
    places = [np.array([walk.fixes[0].x_m, walk.fixes[0].y_m])]
    for before, fix, sensed in zip(walk.fixes, walk.fixes[1:], walk.sensed, strict=False):
        seconds = fix.time_s - before.time_s
        after_mps = accelerated_mps(speed_mps, sensed.acceleration_mps2, seconds)
        walked_m = 0.5 * (speed_mps + after_mps) * seconds
        direction = np.array([np.cos(sensed.heading_rad), np.sin(sensed.heading_rad)])
        places.append(places[-1] + walked_m * direction)
        speed_mps = after_mps
    return np.array(places)


def _errors_m(places: FloatArray, walk: CorridorWalk) -> FloatArray:
    errors_m: FloatArray = np.linalg.norm(places - walk.places, axis=1)[1:]
    return errors_m


def _table(seeds: Sequence[int], set_up: SetUp, params: BlendingParams) -> Figures:
    means: dict[str, list[float]] = {name: [] for name in PUBLISHED_MEANS_M}
    gains = []
    for seed in seeds:
        walk = corridor_walk(np.random.default_rng(seed), set_up)
        track = _follow(walk, params)
        fixes = np.array([(fix.x_m, fix.y_m) for fix in walk.fixes])
        rows = (fixes, _integrated_twice(walk), track.blended, track.filtered)
        errors_m = [_errors_m(places, walk) for places in rows]
        for name, errors in zip(PUBLISHED_MEANS_M, errors_m, strict=True):
            means[name].append(float(errors.mean()))
        near = [100.0 * float(np.mean(errors < NEAR_M)) for errors in errors_m]
        gains.append(near[-1] - near[0])
    wifi = np.array(means["wifi_mean_error_m"])
    return {
        **{name: over_seeds(means[name], mean) for name, mean in PUBLISHED_MEANS_M.items()},
        **{
            f"{row}_ratio": over_seeds(
                np.array(means[f"{row}_mean_error_m"]) / wifi, PUBLISHED_RATIOS[f"{row}_ratio"]
            )
            for row in ("blended", "filtered")
        },
        "points_more_within_3_m": over_seeds(gains, PUBLISHED_GAIN_POINTS),
    }


def _ratios(seeds: Sequence[int], set_up: SetUp, params: BlendingParams) -> Figures:
    table = _table(seeds, set_up, params)
    return {name: table[name] for name in PUBLISHED_RATIOS}


def _fitted(params: BlendingParams) -> BlendingParams:
    """Return the weights fitted on labelled walks, each round on walks followed with the last."""
    walks = [
        corridor_walk(np.random.default_rng(CALIBRATION_SEED + i), SetUp(ROUND))
        for i in range(CALIBRATION_WALKS)
    ]
    for _ in range(ROUNDS):
        epochs = [
            epoch
            for walk in walks
            for epoch in _labelled(_follow(walk, params).motions, walk.places)
        ]
        params = fit_weights(epochs).onto(params)
    return params


def _labelled(motions: Sequence[BlendedMotion], places: FloatArray) -> list[LabelledEpoch]:
    ends = zip(motions, motions[1:], places, places[1:], strict=False)
    return [labelled(*end) for end in ends]


def _worst_error(seed: int) -> float:
    """Return the largest error of a weight fitted on a walk that obeys planted ones."""
    rng = np.random.default_rng(CALIBRATION_SEED + seed)
    walk = corridor_walk(rng, SetUp(ROUND))
    track = _follow(walk, PLANTED)
    marks = track.blended + rng.normal(0.0, MARK_SIGMA_M, track.blended.shape)
    fitted = fit_weights(_labelled(track.motions, marks)).onto(
        BlendingParams((0.0,) * 3, (0.0,) * 3)
    )
    found = (*fitted.speed_weights, *fitted.heading_weights)
    planted = (*PLANTED.speed_weights, *PLANTED.heading_weights)
    return float(np.max(np.abs(np.subtract(found, planted))))
