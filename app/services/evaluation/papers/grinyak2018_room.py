"""The room of grinyak2018: its beacons, and what a phone in it hears and solves."""

import math
from dataclasses import dataclass

import numpy as np

from app.core.engine.grinyak2018 import Grinyak2018Params
from app.core.lateration.windowed import estimate
from app.core.radio.path_loss import LevelModel, expected_levels, level_model
from app.core.radio.windows import Window, window_of
from app.core.types import Anchor, FloatArray, NoFix

ROOM_M = 10.0
CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
WALL_MIDDLES = ((5.0, 0.0), (10.0, 5.0), (5.0, 10.0), (0.0, 5.0))
LAYOUTS = {"corners": CORNERS, "corners_and_middles": CORNERS + WALL_MIDDLES}

PATH_LOSS_EXPONENT = 1.6
"""The paper does not print it; with this one its table comes out."""

NOISE_DB, EPOCHS, PERIOD_S, WALK_MPS = 5.0, 28, 0.07, 1.2

PARAMS = Grinyak2018Params()


@dataclass(frozen=True, slots=True)
class Solution:
    """How far a solution is from the truth, and how significant its velocity.

    No fix errs infinitely; without a velocity there is no significance of one.
    """

    error_m: float
    velocity_chi2: float | None


def room(layout: str) -> LevelModel:
    """Return the level models of a layout's beacons."""
    return level_model(
        tuple(
            Anchor(
                f"{x:g},{y:g}",
                (),
                "room",
                x,
                y,
                path_loss_exponent=PATH_LOSS_EXPONENT,
                shadowing_db=NOISE_DB,
            )
            for x, y in LAYOUTS[layout]
        )
    )


def heard(
    model: LevelModel, time_s: FloatArray, places: FloatArray, rng: np.random.Generator
) -> Window:
    """Return the levels of all beacons at times (n,), heard at places (n, 2)."""
    levels = expected_levels(model, places[:, 0], places[:, 1])
    levels = levels + rng.normal(0.0, NOISE_DB, levels.shape)
    n = model.anchors
    return window_of(np.tile(np.arange(n), len(time_s)), np.repeat(time_s, n), levels.reshape(-1))


def straight(
    place: FloatArray, velocity_mps: FloatArray, epochs: int
) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) and places (n, 2) of a phone that is at a place at time 0, the last one."""
    time_s = np.arange(1.0 - epochs, 1.0) * PERIOD_S
    return time_s, place + time_s[:, None] * velocity_mps


def solved(
    window: Window, model: LevelModel, at_s: float, place: FloatArray, *, kinematic: bool
) -> Solution:
    """Return how a window's solution compares with the true place (2,)."""
    found = estimate(window, model, at_s, kinematic=kinematic, params=PARAMS.lateration)
    if isinstance(found, NoFix):
        return Solution(math.inf, None)
    error_m = math.hypot(found.fix.x_m - place[0], found.fix.y_m - place[1])
    return Solution(error_m, found.velocity_chi2)


def rms(errors: list[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))
