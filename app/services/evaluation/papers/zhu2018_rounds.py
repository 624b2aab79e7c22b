"""The rounds of zhu2018: a rectangle through a hall full of beacons, and three tracks of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from app.core.engine import PROFILES, advance, finish, start
from app.core.engine.state import Stride
from app.core.engine.zhu2018 import mean_place
from app.core.simulate.hall import Hall, Layout, hall, reported, straight_walk
from app.core.simulate.phone import draw_phone
from app.core.simulate.routes import PACE_MPS, WalkTruth
from app.core.simulate.world import SURVEY_SPACING_M
from app.core.types import BleScan, FloatArray, Observation, TrackPoint

LAYOUT = Layout(side_m=70.0, beacon_grid=(10, 5), survey_spacing_m=SURVEY_SPACING_M)
"""50 beacons in 4,900 m²."""

WALK_S = 132.0
LONG_M, SHORT_M = 0.3 * WALK_S * PACE_MPS, 0.2 * WALK_S * PACE_MPS
"""Sides of the rectangle, 3 to 2: all of it is walked in 132 s. The paper does not print them."""

WALL_GAP_M = 5.0
PEOPLE = 3
"""Rounds walked in each hall: a hall is dear to survey, a round is not."""

PARAMS = PROFILES["zhu2018"].params


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One walk around: corners (5, 2), the first also the last, and what the phone told of it."""

    world: Hall
    corners_m: FloatArray
    truth: WalkTruth
    observations: tuple[Observation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """The same seconds by three systems, from the first fix on.

    Attributes
    ----------
    time_s : (n,)
    truth_m, fused_m, fingerprints_m, pedometer_m : (n, 2)
        The pedometer starts from the first fix and keeps to its own headings.
    """

    time_s: FloatArray
    truth_m: FloatArray
    fused_m: FloatArray
    fingerprints_m: FloatArray
    pedometer_m: FloatArray


def walked_rounds(seed: int) -> Iterator[Round]:
    """Yield the rounds of a hall's staff, each elsewhere, with phones as people have them."""
    world_seed, *people = np.random.SeedSequence(seed).spawn(1 + PEOPLE)
    world = hall(LAYOUT, np.random.default_rng(world_seed))
    free_m = LAYOUT.side_m - 2.0 * WALL_GAP_M - np.array([LONG_M, SHORT_M])
    for person in people:
        rng = np.random.default_rng(person)
        corner = WALL_GAP_M + rng.uniform(0.0, 1.0, 2) * free_m
        around = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]) * (LONG_M, SHORT_M)
        truth = straight_walk(corner + around, PACE_MPS)
        told = reported(world, draw_phone(rng), truth, rng)
        yield Round(world, corner + around, truth, told)


def followed(walk: Round) -> Tracks:
    """Return what the profile makes of a round, and its two sources alone."""
    rows = np.array(list(_rows(walk)))
    time_s = rows[:, 0]
    truth_m = walk.truth.points_at(time_s)[:, :2]
    return Tracks(time_s, truth_m, rows[:, 1:3], rows[:, 3:5], rows[:, 5:7])


def _rows(walk: Round) -> Iterator[tuple[float, ...]]:
    """Yield time, fused place, fix and pedometer's place of each scan from the first fix on."""
    site = walk.world.site
    state, pedometer = start(), None
    for observation in walk.observations:
        state, _ = advance(state, observation, site, PARAMS)
        if pedometer is not None:
            pedometer = pedometer + sum(map(_displacement_m, state.evidence.strides))
        sighting = state.evidence.sighting
        if not isinstance(observation, BleScan) or sighting is None:
            continue
        fix_m, point = mean_place(sighting, 0, 0.0), finish(state, site, PARAMS)[-1]
        if fix_m is None or not isinstance(point, TrackPoint):
            continue
        pedometer = np.array(fix_m) if pedometer is None else pedometer
        yield (observation.time_s, point.x_m, point.y_m, *fix_m, *pedometer)


def _displacement_m(stride: Stride) -> FloatArray:
    return stride.length_m * np.array([np.cos(stride.heading_rad), np.sin(stride.heading_rad)])


def backward_jump_m(tracks: Tracks) -> float:
    """Return the longest way that the track goes against the walk within a second."""
    walked_m, moved_m = np.diff(tracks.truth_m, axis=0), np.diff(tracks.fused_m, axis=0)
    along_m = (moved_m * walked_m).sum(axis=1) / np.hypot(*walked_m.T)
    return float(max(0.0, -along_m.min()))


SEARCHED_S = 12.0
"""A track that has not turned so long after a corner has missed it."""

STEADY_S = 3
"""Seconds for which a track keeps to the new leg once it has turned."""


def worst_corner(walk: Round, tracks: Tracks) -> tuple[float, float]:
    """Return the longest time (s) and distance (m) from a corner to where the track turns."""
    legs_m = np.diff(walk.corners_m, axis=0)
    lengths_m = np.hypot(*legs_m.T)
    corner_s = np.cumsum(lengths_m)[:-1] / PACE_MPS
    turns = [
        _turn(tracks, time_s, corner_m, ways)
        for time_s, corner_m, ways in zip(
            corner_s, walk.corners_m[1:-1], pairwise(legs_m / lengths_m[:, None]), strict=True
        )
    ]
    return max(seconds for seconds, _ in turns), max(metres for _, metres in turns)


def _turn(
    tracks: Tracks, corner_s: float, corner_m: FloatArray, ways: tuple[FloatArray, FloatArray]
) -> tuple[float, float]:
    """Return how far in time and place from a corner the track turns.

    It turns where it begins to go more along the new leg than along the old one, and keeps to that.
    """
    before, after = ways
    moved_m = tracks.fused_m[2:] - tracks.fused_m[:-2]
    is_new = moved_m @ after > moved_m @ before
    near = np.flatnonzero(np.abs(tracks.time_s[1:-1] - corner_s) <= SEARCHED_S)
    turned = [i for i in near if is_new[i : i + STEADY_S + 1].all()]
    if not turned:
        return SEARCHED_S, SEARCHED_S * PACE_MPS
    at = turned[0] + 1
    return (
        float(abs(tracks.time_s[at] - corner_s)),
        float(np.hypot(*(tracks.fused_m[at] - corner_m))),
    )
