"""Reproduction of tao2016: what cleaning and smoothing are worth in a simulated corridor.

Source: Tao, Yang, Wang, Zhang, "Indoor fingerprint location optimization technology based on BLE",
Journal of Anhui Agricultural Sciences 44(8), 2016.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.fingerprint.cleaning import CleaningParams, clean_levels
from app.core.fingerprint.wknn import WknnParams, mean_place, nearest, signal_space
from app.core.radio.level_smoothing import (
    LevelSmoothingParams,
    SmoothedLevel,
    first_level,
    next_level,
)
from app.core.types import FloatArray
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.papers.tao2016_corridor import (
    BEACONS,
    PASSERS_BY,
    POINTS,
    SPACING_M,
    Blocking,
    Corridor,
)

PROTOCOL = (
    "corridor of 40 m, 40 reference points at 1 m, 4 beacons that advertise at 4 Hz, surveyed for "
    "20 s each; asked 60 s at each point again, a fix every 5 s from what those 5 s heard; level "
    "of a window and of the map: plain mean, Gauss-mean, or Gauss-mean through the jump-adaptive "
    "filter, begun anew at each point, and two of them in part; weighted 3 nearest points; the "
    "mean error of each over that of plain means"
)

SURVEY_S, STAND_S, WINDOW_S = 20.0, 60.0, 5.0
GAUSS_MEAN_TARGET, ALL_STEPS_TARGET = 0.77, 0.52
"""1.71 and 1.15 m over 2.23 m."""

CLEANING, SMOOTHING = CleaningParams(), LevelSmoothingParams()
WKNN = WknnParams(k=3)
"""The paper does not print its k; along a corridor more than three only pull to the middle."""

POINT_M = (np.arange(POINTS, dtype=np.float64) + 0.5) * SPACING_M

STEP_DB, STEPS, STEP_SAMPLES = 10.0, 30, 20
NOISE_DB, MOST_NOISE_DB = (SMOOTHING.measurement_variance_db2**0.5, 3.0, 4.0), 3.0
"""That of R, the most that the filter is asked to bear, and more."""
SETTLED_SAMPLES, REST_SAMPLES = 60, 2000


@dataclass(frozen=True, slots=True)
class Setting:
    """What differs from the protocol: where is asked, how long bodies block, the window."""

    beside_m: float = 0.0
    blocking: Blocking = PASSERS_BY
    window_s: float = WINDOW_S


SETTINGS = {
    "at_points": Setting(),
    "between_points": Setting(beside_m=0.5 * SPACING_M),
    "blocked_for_5_s": Setting(blocking=replace(PASSERS_BY, mean_s=5.0)),
    "windows_of_2_s": Setting(window_s=2.0),
}
"""The first is the reproduction; the others show where it ends."""


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return the errors and their ratios in every setting, and how the filter follows a step."""
    figures = {name: setting_figures(setting, seeds) for name, setting in SETTINGS.items()}
    for name, target in (("gauss_mean", GAUSS_MEAN_TARGET), ("all_steps", ALL_STEPS_TARGET)):
        figures["at_points"][f"{name}_to_plain_mean_ratio"]["target"] = target
    return {**figures, "jump_adaptive_filter": filter_figures(seeds)}


def setting_figures(setting: Setting, seeds: Sequence[int]) -> dict[str, dict[str, float | None]]:
    """Return the mean error of each method, and its ratio to that of plain means."""
    errors = [_mean_errors_m(setting, np.random.default_rng([2016, seed])) for seed in seeds]
    plain = np.array([error["plain_mean"] for error in errors])
    figures = {}
    for name in errors[0]:
        of_method = np.array([error[name] for error in errors])
        figures[f"{name}_error_m"] = over_seeds(of_method.tolist())
        if name != "plain_mean":
            figures[f"{name}_to_plain_mean_ratio"] = over_seeds((of_method / plain).tolist())
    return figures


def _mean_errors_m(setting: Setting, rng: np.random.Generator) -> dict[str, float]:
    """Return the mean error of each method in one corridor."""
    corridor = Corridor(rng)
    surveyed = corridor.listen_dbm(POINT_M, SURVEY_S, setting.blocking)
    place_m = POINT_M + rng.uniform(-setting.beside_m, setting.beside_m, POINTS)
    heard = corridor.listen_dbm(place_m, STAND_S, setting.blocking)
    windows = heard.reshape(POINTS * round(STAND_S / setting.window_s), -1, BEACONS)
    plain, cleaned = (
        level_of(windows).reshape(POINTS, -1, BEACONS) for level_of in (_plain_means, _gauss_means)
    )
    plain_map, clean_map = _plain_means(surveyed), _gauss_means(surveyed)
    return {
        "plain_mean": _mean_error_m(plain_map, plain, place_m),
        "gauss_mean": _mean_error_m(clean_map, cleaned, place_m),
        "all_steps": _mean_error_m(clean_map, _smoothed(cleaned), place_m),
        "clean_map_alone": _mean_error_m(clean_map, plain, place_m),
        "plain_mean_and_filter": _mean_error_m(plain_map, _smoothed(plain), place_m),
    }


def _plain_means(levels_dbm: FloatArray) -> FloatArray:
    """Return the mean level of each beacon over each place's advertisements, nan if unheard."""
    heard = ~np.isnan(levels_dbm)
    count = heard.sum(axis=1)
    total = np.where(heard, levels_dbm, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _gauss_means(levels_dbm: FloatArray) -> FloatArray:
    """Return the same by Gauss-means."""
    places, advertisements, beacons = levels_dbm.shape
    place, _, beacon = heard = np.nonzero(~np.isnan(levels_dbm))
    scans = np.full(places, advertisements)
    cleaned = clean_levels(place, beacon, levels_dbm[heard], scans, CLEANING)
    means = np.full((places, beacons), np.nan)
    means[cleaned.point, cleaned.transmitter] = cleaned.mean_dbm
    return means


def _smoothed(levels_dbm: FloatArray) -> FloatArray:
    """Return levels (places, windows, beacons) after the filter, which begins anew at each place.

    A window that does not hear a beacon leaves its filter as it is.
    """
    smoothed = np.full_like(levels_dbm, np.nan)
    for place in range(levels_dbm.shape[0]):
        for beacon in range(levels_dbm.shape[2]):
            level: SmoothedLevel | None = None
            for window, level_dbm in enumerate(levels_dbm[place, :, beacon].tolist()):
                if level_dbm == level_dbm:
                    level = _after(level, level_dbm)
                if level is not None:
                    smoothed[place, window, beacon] = level.level_dbm
    return smoothed


def _after(before: SmoothedLevel | None, level_dbm: float) -> SmoothedLevel:
    if before is None:
        return first_level(level_dbm, SMOOTHING)
    return next_level(before, level_dbm, SMOOTHING)


def _mean_error_m(map_dbm: FloatArray, asked_dbm: FloatArray, place_m: FloatArray) -> float:
    """Return the mean error of fixes from levels (places, windows, beacons)."""
    point, beacon = np.nonzero(~np.isnan(map_dbm))
    places = (np.zeros(POINTS, dtype=np.int64), POINT_M, np.zeros(POINTS))
    space = signal_space(places, (point, beacon, map_dbm[point, beacon]), BEACONS, WKNN)
    errors_m = []
    for place, windows in zip(place_m.tolist(), asked_dbm, strict=True):
        for levels_dbm in windows:
            heard = np.flatnonzero(~np.isnan(levels_dbm)).tolist()
            found = nearest({b: float(levels_dbm[b]) for b in heard}, space, WKNN)
            if found is not None:
                errors_m.append(abs(float(mean_place(found)[0][0]) - place))
    return float(np.mean(errors_m))


def filter_figures(seeds: Sequence[int]) -> Figures:
    """Return how soon a step is followed, and how much the filter varies at rest."""
    figures: dict[str, dict[str, float | None]] = {}
    for noise_db in NOISE_DB:
        name = f"noise_{noise_db:.1f}_db".replace(".", "_")
        steps, ratios = zip(*(_follow(noise_db, seed) for seed in seeds), strict=True)
        asked = noise_db <= MOST_NOISE_DB
        figures[f"{name}_samples_to_follow_10_db"] = over_seeds(steps, 8.0 if asked else None)
        figures[f"{name}_variance_to_plain_filter_ratio"] = over_seeds(
            ratios, 1.2 if asked else None
        )
    return figures


def _follow(noise_db: float, seed: int) -> tuple[float, float]:
    """Return after how many samples nine tenths of a step are followed, in the mean of many steps.

    And the variance of the estimate at rest over that of the filter that never jumps.
    """
    rng = np.random.default_rng([2016, seed])
    rest_dbm = rng.normal(-70.0, noise_db, REST_SAMPLES)
    plain = replace(SMOOTHING, jump_ratio=float("inf"))
    ratio = np.var(_filtered(rest_dbm, SMOOTHING)) / np.var(_filtered(rest_dbm, plain))
    steps_dbm = rng.normal(-70.0, noise_db, (STEPS, SETTLED_SAMPLES + STEP_SAMPLES))
    steps_dbm[:, SETTLED_SAMPLES:] += STEP_DB
    followed = np.mean([_filtered(each, SMOOTHING) for each in steps_dbm], axis=0)
    return float(1 + np.argmax(followed >= -70.0 + 0.9 * STEP_DB)), float(ratio)


def _filtered(levels_dbm: FloatArray, params: LevelSmoothingParams) -> FloatArray:
    """Return the estimates of a filter once it has settled."""
    level = first_level(float(levels_dbm[0]), params)
    estimates_dbm = []
    for level_dbm in levels_dbm[1:].tolist():
        level = next_level(level, level_dbm, params)
        estimates_dbm.append(level.level_dbm)
    return np.array(estimates_dbm[SETTLED_SAMPLES - 1 :])
