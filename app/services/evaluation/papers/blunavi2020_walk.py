"""A walk through blunavi2020's wing, and what the walker's phone senses on it.

The walker starts at one end of the corridor, goes into rooms one after the other, around each of
them and back. Steps are told with a trained step length (6 % error a step) and a heading from a
gyroscope, which is a few degrees off from the start and drifts: nothing in the paper corrects it.
Beacons are heard in the corridor alone: in the rooms range updates are missing.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from app.core.motion.step_length import step_lengths_m, swing_root, trained_gain
from app.core.types import BoolArray, FloatArray
from app.services.evaluation.papers.blunavi2020_wing import (
    LENGTH_M,
    ROOM_M,
    ROOMS,
    WIDTH_M,
    Radio,
    in_corridor_y,
)

STEP_S, STEP_M = 0.55, 0.66
ROOMS_VISITED = 6
ADVERTISEMENTS = 4
"""Of each beacon within a step: beacons of navigation systems send 5 to 10 times a second."""
STEPS_PER_SCAN = 4
"""A Wi-Fi scan takes some two seconds."""
LENGTH_NOISE_RATIO = 0.06
TRAINING_STEPS = 60
START_HEADING_RAD = math.radians(4.0)
HEADING_DRIFT_RADPS = math.radians(0.25)
"""Deviation of the gyroscope's bias, chosen so that dead reckoning errs about as published."""
HEADING_NOISE_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """One walk, step by step (n steps).

    Attributes
    ----------
    start : (2,)
        Where it begins; the phone is told.
    place, heading_rad : (n, 2), (n,)
        Where each step ends and where it went.
    in_corridor : (n,)
        Whether it ends in the corridor.
    told_length_m, told_heading_rad : (n,)
        What the phone senses of it.
    beacon_dbm : (n, advertisements, beacons)
        Levels heard within the step; nan in the rooms, and where too quiet.
    wifi_dbm : (n, access points)
        The scan that ended with the step; nan where there was none.
    """

    start: FloatArray
    place: FloatArray
    heading_rad: FloatArray
    in_corridor: BoolArray
    told_length_m: FloatArray
    told_heading_rad: FloatArray
    beacon_dbm: FloatArray
    wifi_dbm: FloatArray


def walk_through(wifi: Radio, beacons: Radio, rng: np.random.Generator) -> Walk:
    """Return a walk and what is sensed on it."""
    corners = _corners(rng)
    length_m, place, heading_rad = _steps(corners, rng)
    count = len(place)
    corridor = in_corridor_y(place[:, 1])
    beacon_dbm = np.stack(
        [beacons.heard_dbm(place, heading_rad, rng) for _ in range(ADVERTISEMENTS)], axis=1
    )
    beacon_dbm[~corridor] = np.nan
    wifi_dbm = wifi.heard_dbm(place, heading_rad, rng)
    wifi_dbm[np.arange(count) % STEPS_PER_SCAN != STEPS_PER_SCAN - 1] = np.nan
    drift_radps = HEADING_DRIFT_RADPS * rng.normal()
    drift_rad = START_HEADING_RAD * rng.normal() + drift_radps * STEP_S * np.arange(count)
    return Walk(
        start=corners[0],
        place=place,
        heading_rad=heading_rad,
        in_corridor=corridor,
        told_length_m=_told_lengths_m(length_m, rng),
        told_heading_rad=heading_rad + drift_rad + HEADING_NOISE_RAD * rng.normal(size=count),
        beacon_dbm=beacon_dbm,
        wifi_dbm=wifi_dbm,
    )


def _corners(rng: np.random.Generator) -> FloatArray:
    """Return the corners of a walk into some rooms and back to the corridor each time."""
    middle = 0.5 * WIDTH_M
    corners = [(1.5, middle)]
    for room in rng.choice(2 * ROOMS, ROOMS_VISITED, replace=False):
        x = ROOM_M * (room % ROOMS + 0.5)
        door, back, side = (WIDTH_M, 1.0, 1.5) if room < ROOMS else (0.0, -1.0, 1.5)
        corners += [(x, middle), (x, door + back * side)]
        corners += [(x - side, door + back * side), (x - side, door + back * 4.5)]
        corners += [(x + side, door + back * 4.5), (x + side, door + back * side)]
        corners += [(x, door + back * side), (x, middle)]
    corners.append((LENGTH_M - 1.5, middle))
    return np.array(corners)


def _steps(
    corners: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return length, end and direction of every step along the corners."""
    usual_m = STEP_M * (1.0 + 0.05 * rng.normal())
    lengths, places, headings = [], [], []
    for a, b in pairwise(corners):
        way_m = float(np.hypot(*(b - a)))
        count = round(way_m / usual_m)
        for i in range(count):
            lengths.append(way_m / count)
            places.append(a + (b - a) * (i + 1) / count)
            headings.append(math.atan2(b[1] - a[1], b[0] - a[0]))
    return np.array(lengths), np.array(places), np.array(headings)


def _told_lengths_m(length_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return step lengths as the trained formula gives them from the swings of these steps."""
    person = 0.3 * (1.0 + 0.1 * rng.normal())

    def root(true_m: FloatArray) -> FloatArray:
        noisy_m = true_m * (1.0 + LENGTH_NOISE_RATIO * rng.normal(size=len(true_m)))
        both = (noisy_m / person) ** 2
        # Vertical swing is twice the forward one.
        return swing_root(both / math.sqrt(2.0), both * math.sqrt(2.0))

    training_m = np.full(TRAINING_STEPS, STEP_M)
    gain = trained_gain(root(training_m), float(training_m.sum()))
    return step_lengths_m(root(length_m), gain)
