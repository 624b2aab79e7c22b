"""A survey of a phone that hears beacons and no Wi-Fi makes a map that locates such a phone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from app.core import engine
from app.core.fingerprint.radio_map import BLE
from app.core.motion.walks import survey_walks
from app.core.params import Params
from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.core.survey import SurveyWalk
from app.core.types import BleScan, Observation, Reading, TrackPoint, Truth, WifiScan
from app.services.radio_map_building import BuildOptions, BuiltMap, built_map

PLAIN = BuildOptions(virtual=False)
WALKS, WALK_S, TRUTH_EVERY_S = 4, 300.0, 10.0


def without_wifi(simulated: SimulatedWalk) -> list[Observation]:
    return [o for o in simulated.observations if not isinstance(o, WifiScan)]


def surveyed(world: Warehouse, seed: int) -> list[SurveyWalk]:
    """Return what an iPhone brings home of five minutes, its surveyor's statements included."""
    simulated = walk(world, seed, 1_000.0 * seed, WALK_S)
    times_s = np.arange(*simulated.truth.time_s[[0, -1]], TRUTH_EVERY_S).tolist()
    truths = []
    for time_s in times_s:
        place = simulated.truth_at(time_s)
        floor = world.site.floors[place.floor_index]
        truths.append(Truth(time_s, place.x_m, place.y_m, floor.floor_id))
    observations = sorted([*without_wifi(simulated), *truths], key=engine.order_key)
    return survey_walks(f"walk-{seed}", observations)


@pytest.fixture(scope="module")
def world() -> Warehouse:
    return warehouse(seed=3)


@pytest.fixture(scope="module")
def built(world: Warehouse) -> BuiltMap:
    walks = [one for seed in range(WALKS) for one in surveyed(world, seed)]
    return built_map(walks, world.site.floors, PLAIN)


def test_walks_without_wifi_become_a_fingerprint_of_beacons_a_second(built: BuiltMap) -> None:
    report, radio_map = built.report, built.radio_map
    assert report.beacon_walks == report.walks > WALKS
    assert set(radio_map.radio.tolist()) == {BLE}
    assert 0.8 * WALKS * WALK_S < radio_map.rows <= report.scans < 1.1 * WALKS * WALK_S
    assert report.kept_out == ()


def test_a_phone_without_wifi_is_located_by_that_map_alone(
    world: Warehouse, built: BuiltMap
) -> None:
    site = replace(world.site, anchors=(), radio_map=built.radio_map)
    carried = walk(world, 91, 50_000.0, 120.0)
    state, errors_m, same_floor = engine.start(), [], []
    for observation in without_wifi(carried):
        state, outputs = engine.advance(state, observation, site, Params())
        for point in outputs:
            if isinstance(point, TrackPoint):
                truth = carried.truth_at(point.time_s)
                errors_m.append(math.hypot(point.x_m - truth.x_m, point.y_m - truth.y_m))
                same_floor.append(site.floors[truth.floor_index].floor_id == point.floor_id)
    assert len(errors_m) > 100
    # Half as much again as measured here; no claim about real buildings.
    assert np.median(errors_m) < 3.2
    assert np.mean(same_floor) > 0.9


def beacon_scan(time_s: float, level_dbm: float, beacons: int = 3) -> BleScan:
    readings = tuple(Reading((f"mac:00000000000{i}",), level_dbm) for i in range(beacons))
    return BleScan(time_s, readings)


def standing(*scans: BleScan | WifiScan) -> SurveyWalk:
    ends = np.array([(0.0, 1.0, 5.0), (10.0, 1.0, 5.0)])
    return SurveyWalk("w", "warehouse-ground", scans, np.zeros((0, 3)), ends)


def test_each_second_has_the_mean_of_the_three_before_it(world: Warehouse) -> None:
    # Louder by 1 dB every quarter of a second.
    scans = [beacon_scan(i / 4.0, -90.0 + i) for i in range(33)]
    radio_map = built_map([standing(*scans)], world.site.floors, PLAIN).radio_map
    assert radio_map.rows == 9
    levels_dbm = radio_map.rssi_dbm.reshape(9, 3)
    # At 8 s those of 5 to 8 s count: 20 to 32 dB above the first.
    assert levels_dbm[-1].tolist() == pytest.approx([-90.0 + 26.0] * 3)
    assert levels_dbm[0].tolist() == pytest.approx([-90.0] * 3)


def test_too_few_beacons_are_no_fingerprint(world: Warehouse) -> None:
    few = [beacon_scan(float(i), -70.0, beacons=2) for i in range(5)]
    enough = [beacon_scan(float(i), -70.0) for i in (8, 9)]
    report = built_map([standing(*few, *enough)], world.site.floors, PLAIN).report
    assert (report.beacon_walks, report.scans, report.placed_scans) == (1, 2, 2)


def test_a_walk_with_wifi_gives_a_fingerprint_per_wifi_scan_and_no_other(world: Warehouse) -> None:
    access_points = tuple(Reading((f"mac:0000000000a{i}",), -60.0) for i in range(3))
    scans = [beacon_scan(float(i), -70.0) for i in range(8)]
    walked = standing(*scans, WifiScan(8.0, access_points))
    built = built_map([walked], world.site.floors, PLAIN)
    assert (built.report.beacon_walks, built.report.scans, built.radio_map.rows) == (0, 1, 1)
    assert len(built.radio_map.transmitters) == 6
