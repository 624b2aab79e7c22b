"""Minutes of rests and walks in the room of grinyak2018: who moves, and what knowing it is worth.

A phone is carried about the room, lies still, is carried again. What it measures besides the levels
comes from `app.core.simulate.phone`: steps as a phone tells them, or its acceleration.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.core.motion.mode import MotionState, decided, with_acceleration, with_step, with_velocity
from app.core.motion.steps import StepDetector, detect_steps
from app.core.radio.path_loss import LevelModel
from app.core.radio.windows import Window, within
from app.core.simulate import WalkTruth
from app.core.simulate.phone import draw_phone, imu_blocks, steps
from app.core.types import BoolArray, ImuBlock, MotionMode
from app.services.evaluation.papers.grinyak2018_room import (
    PARAMS,
    PERIOD_S,
    ROOM_M,
    WALK_MPS,
    Solution,
    heard,
    rms,
    solved,
)

DURATION_S, STRETCH_S = 180, (10.0, 30.0)
RATE_HZ = 10
WALL_M = 1.0
"""Walkers keep this far from the walls."""


@dataclass(frozen=True, slots=True)
class Second:
    """What tells of motion in one second: steps, acceleration, the velocity that levels show."""

    steps_s: Sequence[float] = ()
    block: ImuBlock | None = None
    velocity_chi2: float | None = None


@dataclass(frozen=True, slots=True)
class Asked:
    """The window that ends with a second: whether most of it was a walk, and its solutions."""

    walking: bool
    static: Solution
    kinematic: Solution


def rests_and_walks(model: LevelModel, window_s: int, rng: np.random.Generator) -> dict[str, float]:
    """Return how often the mode is right by each evidence, and which errors follow from it."""
    truth, walking = _carried(rng)
    levels = _levels(model, truth, rng)
    asked = [
        _ask(model, levels, (truth, walking), (second - window_s, second))
        for second in range(window_s, DURATION_S)
    ]
    modes = {
        name: _modes(seconds)[window_s - 1 : DURATION_S - 1]
        for name, seconds in _evidence(truth, asked, rng).items()
    }
    known_m = _rms_by([each.walking for each in asked], asked)
    figures = {
        f"mode_right_share_by_{name}": float(
            np.mean([each.walking == mode for each, mode in zip(asked, said, strict=True)])
        )
        for name, said in modes.items()
    }
    for name, said in modes.items():
        figures[f"error_by_{name}_over_known_motion"] = _rms_by(said, asked) / known_m
    for name, always in (("static", False), ("kinematic", True)):
        figures[f"error_always_{name}_over_known_motion"] = (
            _rms_by([always] * len(asked), asked) / known_m
        )
    return figures


def _carried(rng: np.random.Generator) -> tuple[WalkTruth, BoolArray]:
    """Return a way of rests and walks from goal to goal, and when it is a walk (n,)."""
    time_s = np.arange(DURATION_S * RATE_HZ + 1) / RATE_HZ
    borders_s = np.cumsum(rng.uniform(*STRETCH_S, math.ceil(DURATION_S / STRETCH_S[0])))
    walking = np.searchsorted(borders_s, time_s) % 2 == 1
    walked_m = np.concatenate(([0.0], np.cumsum(walking[1:] * WALK_MPS / RATE_HZ)))
    goals = rng.uniform(WALL_M, ROOM_M - WALL_M, (DURATION_S, 2))
    corner_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(goals, axis=0).T))))
    x_m, y_m = (np.interp(walked_m, corner_m, axis) for axis in goals.T)
    return WalkTruth(time_s, x_m, y_m, np.zeros(len(time_s)), walked_m, ()), walking


def _levels(model: LevelModel, truth: WalkTruth, rng: np.random.Generator) -> Window:
    """Return all levels that are heard on the way."""
    epochs_s = np.arange(0.0, DURATION_S, PERIOD_S)
    return heard(model, epochs_s, truth.points_at(epochs_s)[:, :2], rng)


def _ask(
    model: LevelModel,
    levels: Window,
    carried: tuple[WalkTruth, BoolArray],
    second: tuple[int, int],
) -> Asked:
    """Return the window between two seconds, solved for the latter."""
    (truth, walking), (begin_s, end_s) = carried, second
    window = within(levels, begin_s, end_s)
    place = truth.points_at(np.array([float(end_s)]))[0, :2]
    static, kinematic = (
        solved(window, model, float(end_s), place, kinematic=each) for each in (False, True)
    )
    moving = walking[begin_s * RATE_HZ : end_s * RATE_HZ].mean() > 0.5
    return Asked(bool(moving), static, kinematic)


def _evidence(
    truth: WalkTruth, asked: Sequence[Asked], rng: np.random.Generator
) -> dict[str, list[Second]]:
    """Return what each kind of phone tells, second by second."""
    phone = draw_phone(rng)
    told_s = _by_second(step.time_s for step in steps(phone, truth, rng))
    blocks = imu_blocks(phone, truth, rng)
    found_s = _by_second(_found(blocks))
    unasked: list[float | None] = [None] * (DURATION_S - len(asked) - 1)
    significance = unasked + [each.kinematic.velocity_chi2 for each in asked]
    return {
        "steps": [Second(steps_s=each) for each in told_s],
        "imu": [Second(s, block) for s, block in zip(found_s, blocks, strict=True)],
        "both": [Second(s, block) for s, block in zip(told_s, blocks, strict=True)],
        "levels": [Second(velocity_chi2=each) for each in significance],
    }


def _found(blocks: Iterable[ImuBlock]) -> Iterator[float]:
    detector = StepDetector()
    for block in blocks:
        detector, found = detect_steps(detector, block, PARAMS.step)
        yield from (step.time_s for step in found)


def _by_second(times_s: Iterable[float]) -> list[list[float]]:
    """Return what is known at the end of each second since the one before."""
    seconds: list[list[float]] = [[] for _ in range(DURATION_S)]
    for time_s in times_s:
        seconds[min(max(math.ceil(time_s) - 1, 0), DURATION_S - 1)].append(time_s)
    return seconds


def _modes(seconds: Sequence[Second]) -> list[bool]:
    """Return whether the phone is held for a walker's at the end of each second."""
    state, params = MotionState(), PARAMS.motion_mode
    walking = []
    for end_s, second in enumerate(seconds, start=1):
        if second.block is not None:
            state = with_acceleration(state, second.block, params)
        for time_s in second.steps_s:
            state = with_step(state, time_s)
        if second.velocity_chi2 is not None:
            state = with_velocity(state, float(end_s), second.velocity_chi2)
        state = decided(state, float(end_s), params)
        walking.append(state.mode is MotionMode.WALKING)
    return walking


def _rms_by(walking: Sequence[bool], asked: Sequence[Asked]) -> float:
    """Return the error when each window is solved by the model that a mode calls for."""
    return rms(
        [
            (each.kinematic if moving else each.static).error_m
            for each, moving in zip(asked, walking, strict=True)
        ]
    )
