"""The simulated warehouse: the same for the same seed, and true to the model it states."""

from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import order_key
from app.core.simulate import ConnectorKind, Rack, SimulatedWalk, Warehouse, walk, warehouse
from app.core.simulate.building import CONNECTORS
from app.core.simulate.radio import FADING_DB
from app.core.types import BleScan, ImuBlock, Steps, WifiScan

START_S = 1_790_000_000.0


@pytest.fixture(scope="module")
def world() -> Warehouse:
    return warehouse(seed=7)


@pytest.fixture(scope="module")
def walks(world: Warehouse) -> list[SimulatedWalk]:
    return [walk(world, seed, START_S, 400.0) for seed in range(12)]


def test_same_seed_gives_the_same_world_and_walk_and_another_seed_another() -> None:
    one, again, other = warehouse(3), warehouse(3), warehouse(4)
    assert one.site.anchors == again.site.anchors
    assert one.site.radio_map.rssi_dbm.tobytes() == again.site.radio_map.rssi_dbm.tobytes()
    assert one.site.anchors != other.site.anchors
    walks = [walk(w, 5, START_S, 60.0, imu=True) for w in (one, again)]
    keys = [[order_key(o) for o in w.observations] for w in walks]
    assert keys[0] == keys[1]
    assert walks[0].truth.x_m.tobytes() == walks[1].truth.x_m.tobytes()
    assert walk(one, 6, START_S, 60.0).observations != walk(one, 5, START_S, 60.0).observations


def test_observations_come_in_the_order_of_the_fold(walks: list[SimulatedWalk]) -> None:
    for one in walks:
        times = [order_key(o)[:2] for o in one.observations]
        assert times == sorted(times)


def test_walkers_never_pass_racks_or_walls(world: Warehouse, walks: list[SimulatedWalk]) -> None:
    later = [walk(world, seed, START_S, 200.0, after=one) for seed, one in enumerate(walks)]
    for one in (*walks, *later):
        truth = one.truth
        for x_m, y_m, floor in zip(truth.x_m, truth.y_m, truth.floor_index, strict=True):
            walkable = world.site.floors[floor].walkable
            assert walkable is not None
            assert walkable.distance_at(x_m, y_m) == 0.0, (x_m, y_m, floor)


def test_speeds_are_those_of_people(walks: list[SimulatedWalk]) -> None:
    for one in walks:
        distance_m = np.hypot(np.diff(one.truth.x_m), np.diff(one.truth.y_m))
        speed_mps = distance_m / np.diff(one.truth.time_s)
        assert speed_mps.max() < 2.2
        assert 0.8 < np.median(speed_mps[speed_mps > 0.3]) < 1.6
        assert 0.02 < np.mean(speed_mps < 0.01) < 0.7, "pauses are part of every walk"


def _over(box: Rack, x_m: float, y_m: float) -> bool:
    """Return whether a place is in a footprint, give or take the sway of a walker."""
    centre_m = (box.x0_m + box.width_m / 2, box.y0_m + box.depth_m / 2)
    sway_m = 0.4
    inside_x = abs(x_m - centre_m[0]) <= box.width_m / 2 + sway_m
    return inside_x and abs(y_m - centre_m[1]) <= box.depth_m / 2 + sway_m


def test_floors_change_only_on_the_stairs_and_in_the_lift(walks: list[SimulatedWalk]) -> None:
    kinds = set()
    for one in walks:
        truth = one.truth
        between = np.flatnonzero((truth.storey > 0.0) & (truth.storey < 1.0))
        for x_m, y_m in zip(truth.x_m[between], truth.y_m[between], strict=True):
            assert any(_over(c.footprint, x_m, y_m) for c in CONNECTORS), (x_m, y_m)
        assert np.abs(np.diff(truth.storey)).max() < 0.02, "nobody jumps between floors"
        for change in one.truth.floor_changes:
            kinds.add(change.kind)
            assert one.truth_at(change.end_s).floor_index == change.to_floor_index
            assert one.truth_at(change.begin_s).floor_index != change.to_floor_index
    assert kinds == set(ConnectorKind)


def _field_sample(world: Warehouse, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return shadowing at random places and at places 4 and 20 m from them: (3, places, APs)."""
    rng = np.random.default_rng(seed)
    place = np.column_stack([rng.uniform(20, 60, 400), rng.uniform(20, 30, 400), np.zeros(400)])
    direction = rng.uniform(0, 2 * np.pi, 400)
    away = np.column_stack([np.cos(direction), np.sin(direction), np.zeros(400)])
    radio = world.beacons
    return np.stack([radio.shadowing_db(place + r * away) for r in (0.0, 4.0, 20.0)])


def test_shadowing_has_its_deviation_and_its_correlation_in_space(world: Warehouse) -> None:
    here, near, far = _field_sample(world, 1)
    assert here.std() == pytest.approx(4.0, rel=0.15)
    assert abs(here.mean()) < 0.6
    correlation_near = np.mean(here * near) / np.mean(here**2)
    correlation_far = np.mean(here * far) / np.mean(here**2)
    assert correlation_near == pytest.approx(np.exp(-1.0), abs=0.12)
    assert abs(correlation_far) < 0.12


def test_levels_are_log_distance_where_nothing_stands_between(world: Warehouse) -> None:
    anchor = next(a for a in world.site.anchors if a.floor_id == "warehouse-ground")
    index = world.site.anchors.index(anchor)
    still_air = replace(world.beacons, model=world.beacons.model * (1.0, 1.0, 1.0, 0.0))
    # A metre along the aisle that the beacon hangs over: 1.3 m below, so hypot(1, 1.3) m away.
    point = np.array([[anchor.x_m, anchor.y_m + 1.0, 0.0]])
    level_dbm = still_air.mean_levels_dbm(point)[0, index]
    loss_db = 10.0 * anchor.path_loss_exponent * np.log10(np.hypot(1.0, 1.3))
    assert level_dbm == pytest.approx(anchor.ref_level_dbm - loss_db)
    above = still_air.mean_levels_dbm(point + np.array([0.0, 0.0, 1.0]))[0, index]
    assert above < level_dbm - 15.0, "the slab costs at least 15 dB"


def test_racks_weaken_what_passes_them(world: Warehouse) -> None:
    radio = replace(world.beacons, model=world.beacons.model * (1.0, 1.0, 0.0, 0.0))
    points = np.array([[9.5, 15.0, 0.0]])
    loss_db = radio.model[:, 0] - radio.mean_levels_dbm(points)[0]
    across = [
        loss
        for loss, a in zip(loss_db, radio.anchors, strict=True)
        if a.floor_id == "warehouse-ground" and a.x_m > 25.0 and abs(a.y_m - 15.0) < 5.0
    ]
    assert across
    assert min(across) >= 10.0, "at least two racks lie between"
    assert max(across) == pytest.approx(20.0), "and the way over their tops bounds the loss"


def test_readings_are_the_model_plus_the_phones_offset(
    world: Warehouse, walks: list[SimulatedWalk]
) -> None:
    offsets = [one.phone.level_offset_db for one in walks]
    assert min(offsets) < -1.0 < 1.0 < max(offsets)
    residual_db = np.concatenate([_residual_db(world, one) for one in walks])
    assert abs(residual_db.mean()) < 0.1
    assert residual_db.std() == pytest.approx(FADING_DB, rel=0.05)


def _residual_db(world: Warehouse, one: SimulatedWalk) -> np.ndarray:
    """Return reported levels less model and offset, of levels far above the threshold."""
    index = {a.keys: i for i, a in enumerate(world.beacons.anchors)}
    heard = [
        (scan.time_s - reading.age_s, index[reading.keys], reading.rssi_dbm)
        for scan in one.observations
        if isinstance(scan, BleScan)
        for reading in scan.readings
    ]
    time_s, column, rssi_dbm = (np.array(values) for values in zip(*heard, strict=True))
    instants_s, row = np.unique(time_s, return_inverse=True)
    level_dbm = world.beacons.mean_levels_dbm(one.truth.points_at(instants_s))[row, column]
    # Nearer to the threshold the quiet ones are missing and would bias the mean.
    loud = level_dbm > -80.0
    return (rssi_dbm - level_dbm - one.phone.level_offset_db)[loud]


def test_scans_are_paced_and_quiet_transmitters_not_heard(walks: list[SimulatedWalk]) -> None:
    for one in walks:
        ble = [o for o in one.observations if isinstance(o, BleScan)]
        wifi = [o for o in one.observations if isinstance(o, WifiScan)]
        assert len(ble) == 400
        assert np.all(np.diff([s.time_s for s in wifi]) < 4.01)
        assert np.all(np.diff([s.time_s for s in wifi]) > 1.99)
        quietest = min(r.rssi_dbm for s in ble for r in s.readings)
        assert quietest >= -96.5 + one.phone.level_offset_db


def test_steps_add_up_to_the_way_walked_and_point_along_it(walks: list[SimulatedWalk]) -> None:
    for one in walks:
        told = [o for o in one.observations if isinstance(o, Steps)]
        walked_m = len(told) * one.phone.step_length_m / (1.0 - one.phone.miss_probability)
        assert walked_m == pytest.approx(one.truth.walked_m[-1], rel=0.05)
        assert {o.count for o in told} == {1}
        error_rad = []
        for step in told:
            before, after = one.truth_at(step.time_s - 0.4), one.truth_at(step.time_s)
            heading_rad = np.arctan2(after.y_m - before.y_m, after.x_m - before.x_m)
            assert step.heading_rad is not None
            error_rad.append(np.angle(np.exp(1j * (step.heading_rad - heading_rad))))
        middle_s = np.mean([s.time_s for s in told]) - START_S
        expected_rad = one.phone.holding_rad + one.phone.drift_radps * middle_s
        assert np.median(error_rad) == pytest.approx(expected_rad, abs=0.05)


def test_imu_blocks_hold_a_swing_per_step_and_the_heading(world: Warehouse) -> None:
    one = walk(world, 2, START_S, 120.0, imu=True)
    blocks = [o for o in one.observations if isinstance(o, ImuBlock)]
    assert len(blocks) == 120
    assert not any(isinstance(o, Steps) for o in one.observations)
    up = np.concatenate([b.acc_mps2[:, 2] for b in blocks])
    smooth = np.convolve(up - up.mean(), np.full(7, 1 / 7), mode="same")
    peaks = (smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:]) & (smooth[1:-1] > 1.0)
    walked_m = one.truth.walked_m[-1]
    assert peaks.sum() == pytest.approx(walked_m / one.phone.step_length_m, rel=0.06)
    quat = np.concatenate([b.quat_wxyz for b in blocks])
    heading_rad = 2.0 * np.arctan2(quat[:, 3], quat[:, 0]) + np.pi / 2.0
    gyro = np.concatenate([b.gyro_radps[:, 2] for b in blocks])
    turned_rad = np.unwrap(heading_rad)
    assert gyro.sum() / 50.0 == pytest.approx(turned_rad[-1] - turned_rad[0], abs=0.2)


def test_a_walk_goes_on_where_the_one_before_ended(world: Warehouse) -> None:
    first = walk(world, 1, START_S, 60.0)
    second = walk(world, 1, START_S + 60.0, 60.0, after=first)
    end, begin = first.truth_at(START_S + 60.0), second.truth_at(START_S + 60.0)
    # Half a metre each of swaying.
    assert np.hypot(end.x_m - begin.x_m, end.y_m - begin.y_m) < 1.0
    assert second.phone == first.phone
    assert second.truth.x_m.tobytes() != first.truth.x_m.tobytes()


def test_the_survey_covers_both_floors_along_the_aisles(world: Warehouse) -> None:
    radio_map = world.site.radio_map
    assert radio_map is not None
    assert radio_map.floor_ids == tuple(f.floor_id for f in world.site.floors)
    assert np.bincount(radio_map.floor_index).min() > 200
    assert np.diff(radio_map.row_start).min() > 5, "something is heard everywhere"
    dense = world.fingerprints(seed=1, spacing_m=1.0)
    assert len(dense) > 1.7 * radio_map.rows
