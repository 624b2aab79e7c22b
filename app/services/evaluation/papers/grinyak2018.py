"""Reproduction of grinyak2018: windowed least squares on beacon levels in a room of 10 x 10 m.

Source: Grinyak, Grinyak, Tsybanov, "Indoor positioning system based on Bluetooth beacons", The
Territory of New Opportunities 10(2), 2018.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy import stats

from app.core.lateration.predicted import (
    Schedule,
    cell_centres,
    predicted_covariance,
    predicted_sigma_m,
)
from app.core.motion.mode import MotionState, decided, with_velocity
from app.core.radio.path_loss import LevelModel
from app.core.radio.windows import Window
from app.core.types import FloatArray, MotionMode
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.papers.grinyak2018_room import (
    EPOCHS,
    LAYOUTS,
    PARAMS,
    ROOM_M,
    WALK_MPS,
    Solution,
    heard,
    rms,
    room,
    solved,
    straight,
)
from app.services.evaluation.papers.grinyak2018_walk import rests_and_walks

PROTOCOL = (
    "room of 10 x 10 m, beacons in its corners, or there and in the middles of its walls, "
    "path-loss exponent 1.6, noise 5 dB, windows of 28 epochs of 0.07 s, reference time the last "
    "epoch; per seed 100 solutions of a phone at rest somewhere in the room; 20 straight walks at "
    "1.2 m/s, and 40 phones at rest, for each length of window; 3 minutes of rests and walks "
    "of 10 to 30 s each, asked every second with windows of 2 and 3 s, a window being a walk if "
    "more than half of it is"
)

Way: TypeAlias = tuple[FloatArray, FloatArray]
"""Times (n,), the last of them 0, and places (n, 2) of a phone."""

CELL_M = 0.5
PUBLISHED_KINEMATIC_M = {"corners": (1.9, 2.5), "corners_and_middles": (0.9, 1.2)}
SOLUTIONS, BAND = 100, 0.99
WALKS, RESTS = 20, 40
PREDICTED, IN_BAND = "_predicted", "_in_band_share"
"""Ends of the names of what D says of a figure, and of whether the figure agrees with it."""

MODELS = {"static": False, "kinematic": True}
"""Models of the phone, and whether they have a velocity."""

CARRIED_WINDOWS_S = (2, 3)
WINDOW_EPOCHS = {"2s": EPOCHS, "3s": 43, "4s": 57, "6s": 86}
"""The published window, and where longer ones lead."""

TARGETS = {
    "static_over_kinematic_at_rest": 0.5,
    "static_rms_over_sigma": 1.0,
    "kinematic_rms_over_sigma": 1.0,
    **{f"static_over_kinematic_walking_{window}": 2.0 for window in WINDOW_EPOCHS},
    **{f"false_motion_share_{window}": 0.05 for window in WINDOW_EPOCHS},
    "mode_right_share_by_steps_2s": 0.97,
    "mode_right_share_by_imu_2s": 0.97,
    "mode_right_share_by_both_2s": 0.97,
    **{
        f"error_by_{evidence}_over_known_motion_{window_s}s": 1.0
        for evidence in ("steps", "imu", "both")
        for window_s in CARRIED_WINDOWS_S
    },
}


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return what D predicts for both layouts, what solutions scatter by, and who seems to move."""
    figures: dict[str, Figures] = {}
    for layout in LAYOUTS:
        model = room(layout)
        scattered = [_scatter(model, np.random.default_rng((seed, 1))) for seed in seeds]
        walked = [_walk_straight(model, np.random.default_rng((seed, 2))) for seed in seeds]
        figures[layout] = {"predicted": _predicted(layout), **_over(scattered), **_over(walked)}
    return {**figures, "rests_and_walks": _over([_carry(seed) for seed in seeds])}


def _carry(seed: int) -> dict[str, float]:
    """Return who seems to move in the same minutes of rests and walks, by length of window."""
    figures: dict[str, float] = {}
    for window_s in CARRIED_WINDOWS_S:
        rng = np.random.default_rng((seed, 3))
        told = rests_and_walks(room("corners_and_middles"), window_s, rng)
        figures |= {f"{name}_{window_s}s": value for name, value in told.items()}
    return figures


def _over(runs: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """Return each figure over the seeds, with its target or the median of what D predicts for it.

    Of a figure that is yes or no it is the share of yes.
    """
    by_name = {name: [run[name] for run in runs] for name in runs[0]}
    figures: dict[str, Any] = {}
    for name, values in by_name.items():
        if name.endswith(IN_BAND):
            figures[name] = float(np.mean(values))
        elif not name.endswith(PREDICTED):
            predicted = by_name.get(name + PREDICTED)
            target = float(np.median(predicted)) if predicted else TARGETS.get(name)
            figures[name] = over_seeds(values, target)
    return figures


def _predicted(layout: str) -> Figures:
    """Return the range of ``sigma_xy`` over the room's cells, by model."""
    x, y = cell_centres(ROOM_M, ROOM_M, CELL_M)
    figures = {}
    for name, kinematic in MODELS.items():
        sigma_m = predicted_sigma_m(room(layout), x, y, Schedule(), kinematic=kinematic)
        low_m, high_m = PUBLISHED_KINEMATIC_M[layout]
        half = 1.0 if kinematic else 0.5
        figures[f"least_{name}_sigma_m"] = _alone(float(sigma_m.min()), half * low_m)
        figures[f"most_{name}_sigma_m"] = _alone(float(sigma_m.max()), half * high_m)
    return figures


def _alone(value: float, target: float) -> dict[str, float | None]:
    """Return a figure in which nothing is random."""
    return {"median": value, "p10": None, "p90": None, "target": target}


def _scatter(model: LevelModel, rng: np.random.Generator) -> dict[str, float]:
    """Return how the solutions of a phone at rest in one place scatter, against what D says."""
    place = np.asarray((rng.integers(round(ROOM_M / CELL_M), size=2) + 0.5) * CELL_M, np.float64)
    time_s, places = straight(place, np.zeros(2), EPOCHS)
    windows = [heard(model, time_s, places, rng) for _ in range(SOLUTIONS)]
    figures, rms_m = {}, {}
    for name, kinematic in MODELS.items():
        errors = [solved(w, model, 0.0, place, kinematic=kinematic).error_m for w in windows]
        covariance_m2 = predicted_covariance(
            model, place[:1], place[1:], Schedule(), kinematic=kinematic
        )[0]
        sigma_m = float(np.sqrt(np.trace(covariance_m2)))
        predicted_share = share_inside(covariance_m2, 2.0 * sigma_m)
        inside = int(np.sum(np.array(errors) <= 2.0 * sigma_m))
        low, high = stats.binom.interval(BAND, SOLUTIONS, predicted_share)
        share = f"{name}_share_inside_2_sigma"
        rms_m[name] = rms(errors)
        figures[share] = inside / SOLUTIONS
        figures[share + PREDICTED] = predicted_share
        figures[share + IN_BAND] = float(low <= inside <= high)
        figures[f"{name}_rms_over_sigma"] = rms_m[name] / sigma_m
    return {**figures, "static_over_kinematic_at_rest": rms_m["static"] / rms_m["kinematic"]}


def share_inside(covariance_m2: FloatArray, radius_m: float) -> float:
    """Return the share of a plane normal, covariance (2, 2), inside a circle around its mean.

    In polar coordinates the radial integral is closed; the angles are summed:
    ``P = mean over t of (1 - exp(-r^2 g / 2)) / (g sqrt(a b))``, ``g = cos^2 t / a + sin^2 t / b``,
    with a and b the eigenvalues of the covariance.
    """
    a, b = np.linalg.eigvalsh(covariance_m2)
    t = np.linspace(0.0, np.pi, 720, endpoint=False)
    g = np.cos(t) ** 2 / a + np.sin(t) ** 2 / b
    return float(np.mean((1.0 - np.exp(-0.5 * radius_m**2 * g)) / g) / np.sqrt(a * b))


def _walk_straight(model: LevelModel, rng: np.random.Generator) -> dict[str, float]:
    """Return how both models fare with a walker, and what levels alone know of motion."""
    figures = {}
    for name, epochs in WINDOW_EPOCHS.items():
        walks = [_hear(model, _way_through(rng, epochs), rng) for _ in range(WALKS)]
        rests = [_hear(model, _rest(rng, epochs), rng) for _ in range(RESTS)]
        walking = {
            each: [solved(window, model, 0.0, place, kinematic=moves) for window, place in walks]
            for each, moves in MODELS.items()
        }
        resting = [solved(window, model, 0.0, place, kinematic=True) for window, place in rests]
        static_m, kinematic_m = (rms([s.error_m for s in of]) for of in walking.values())
        figures[f"static_over_kinematic_walking_{name}"] = static_m / kinematic_m
        figures[f"motion_found_share_{name}"] = _moving_share(walking["kinematic"])
        figures[f"false_motion_share_{name}"] = _moving_share(resting)
    return figures


def _way_through(rng: np.random.Generator, epochs: int) -> Way:
    """Return a straight walk of that long, all of it in the room."""
    while True:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        velocity_mps = WALK_MPS * np.array([np.cos(angle), np.sin(angle)])
        time_s, places = straight(rng.uniform(0.0, ROOM_M, 2), velocity_mps, epochs)
        if np.all((places[0] >= 0.0) & (places[0] <= ROOM_M)):
            return time_s, places


def _rest(rng: np.random.Generator, epochs: int) -> Way:
    """Return a phone that lies anywhere in the room."""
    return straight(rng.uniform(0.0, ROOM_M, 2), np.zeros(2), epochs)


def _hear(model: LevelModel, way: Way, rng: np.random.Generator) -> tuple[Window, FloatArray]:
    """Return the window heard on a way, and where that ends."""
    time_s, places = way
    return heard(model, time_s, places, rng), places[-1]


def _moving_share(solutions: Sequence[Solution]) -> float:
    """Return the share of windows that are held for a walker's, each on its own."""
    modes = [
        decided(with_velocity(MotionState(), 0.0, s.velocity_chi2 or 0.0), 0.0, PARAMS.motion_mode)
        for s in solutions
    ]
    return float(np.mean([each.mode is MotionMode.WALKING for each in modes]))
