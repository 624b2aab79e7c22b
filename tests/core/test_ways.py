"""Ways: people go where the survey walked, and nobody is held where it did not."""

import math

import numpy as np
import pytest

from app.core.fingerprint.growth import GROWN
from app.core.fingerprint.paths import LONGEST_M, paths
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.fusion.ground import ground, way_log_weight
from app.core.fusion.particles import begin, moments, walk
from app.core.fusion.sighting import Sighting
from app.core.fusion.ways import NO_WAYS, WayParams, ways
from app.core.params import FusionParams

EAST = (1.0, 0.0)
AISLE = np.array([[0.0, 0.0, 40.0, 0.0]])
AISLES = np.array([[0.0, y, 40.0, y] for y in np.arange(-12.0, 13.0, 3.0)])
CROSSING = np.vstack([AISLE, [[20.0, -20.0, 20.0, 20.0]]])


def weight_at(paths_m, x_m, y_m, direction_rad, east=EAST):
    floor = ground(None, east, ways(paths_m, east, WayParams()))
    return way_log_weight(floor, x_m, y_m, direction_rad)


def test_along_a_walk_is_likelier_than_across_it():
    assert weight_at(AISLE, 20.0, 0.0, 0.05) == 0.0
    assert weight_at(AISLE, 20.0, 0.0, math.pi / 2.0) < -3.0


def test_there_and_back_are_alike():
    for direction in np.linspace(0.1, 3.0, 7):
        there = weight_at(AISLE, 12.0, 0.5, direction)
        assert weight_at(AISLE, 12.0, 0.5, direction + math.pi) == there


def test_both_directions_of_a_crossing_are_ways():
    assert weight_at(CROSSING, 20.0, 0.0, 0.05) > -0.1
    assert weight_at(CROSSING, 20.0, 0.0, math.pi / 2.0 + 0.05) > -0.1
    assert weight_at(CROSSING, 20.0, 0.0, math.pi / 4.0) < -1.0


def test_where_nobody_walked_all_directions_are_alike():
    assert weight_at(AISLE, 20.0, 5.5, math.pi / 2.0) > -0.2
    assert weight_at(AISLE, 500.0, 300.0, math.pi / 2.0) == 0.0
    assert ways(np.empty((0, 4)), EAST, WayParams()) is NO_WAYS


def test_a_plan_that_is_turned_turns_its_ways():
    turn_rad = 0.7
    turn = np.array(
        [[math.cos(turn_rad), -math.sin(turn_rad)], [math.sin(turn_rad), math.cos(turn_rad)]]
    )
    turned = (CROSSING.reshape(-1, 2) @ turn.T).reshape(-1, 4)
    east = (math.cos(turn_rad), math.sin(turn_rad))
    for place in ((7.3, 0.4), (20.6, -3.2), (33.1, 2.2)):
        x, y = turn @ place
        for direction in (0.3, 1.2, 2.4):
            plain = weight_at(CROSSING, *place, direction)
            assert weight_at(turned, x, y, direction + turn_rad, east) == pytest.approx(plain)


def test_a_walker_among_aisles_learns_its_heading_from_them():
    seen = Sighting(0.0, np.array([[2.0, 0.0]]), np.ones(1), (1.0, 0.0, 1.0), np.ones(1))
    spread = {}
    for name, known in (("aisles", ways(AISLES, EAST, WayParams())), ("open", NO_WAYS)):
        floor = ground(None, EAST, known)
        particles = begin(seen, floor, FusionParams())
        for _ in range(30):
            particles = walk(particles, (0.7, 0.0), floor, FusionParams())
        spread[name] = math.sqrt(moments(particles)[1][1, 1])
    assert spread["aisles"] < 0.8 * spread["open"]


def a_map(*rows):
    prints = [Fingerprint(0, x, y, {"w": -50.0}, {}, walk_name) for x, y, walk_name in rows]
    return build_radio_map(("f0", "f1"), prints)


def test_paths_join_a_walks_fingerprints_one_after_the_other():
    radio_map = a_map((0, 0, "a"), (9, 9, "b"), (3, 0, "a"), (9, 5, "b"), (3, 4, "a"))
    found = sorted(map(tuple, paths(radio_map, 0)))
    assert found == [(0, 0, 3, 0), (3, 0, 3, 4), (9, 9, 9, 5)]
    assert not len(paths(radio_map, 1))


def test_paths_leave_out_gaps_standing_and_what_nobody_walked():
    radio_map = a_map(
        (0, 0, "a"),
        (0, 0, "a"),
        (LONGEST_M + 1.0, 0, "a"),
        (0, 1, VIRTUAL_WALK),
        (0, 2, VIRTUAL_WALK),
        (0, 3, f"{GROWN}phone"),
        (0, 4, f"{GROWN}phone"),
    )
    assert not len(paths(radio_map, 0))
