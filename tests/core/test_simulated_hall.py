"""The open hall: even walks, a survey that tells places apart, the same for the same seed."""

import numpy as np
import pytest

from app.core.simulate.hall import Layout, hall, reported, straight_walk
from app.core.simulate.phone import Phone
from app.core.types import BleScan, Steps

LAYOUT = Layout(side_m=20.0, beacon_grid=(3, 2), survey_spacing_m=4.0)
CORNERS_M = np.array([(2.0, 2.0), (14.0, 2.0), (14.0, 8.0)])
PHONE = Phone(level_offset_db=0.0, holding_rad=0.0, drift_radps=0.0, step_length_m=0.7)


def test_a_walk_goes_evenly_from_corner_to_corner() -> None:
    truth = straight_walk(CORNERS_M, pace_mps=1.2)
    assert truth.time_s[-1] == pytest.approx(15.0)
    assert truth.points_at(np.array([0.0, 5.0, 10.0, 15.0])) == pytest.approx(
        np.array([(2.0, 2.0, 0.0), (8.0, 2.0, 0.0), (14.0, 2.0, 0.0), (14.0, 8.0, 0.0)])
    )
    assert truth.walked_m[-1] == pytest.approx(18.0)


def test_the_survey_covers_the_hall_and_is_louder_by_a_beacon() -> None:
    world = hall(LAYOUT, np.random.default_rng(1))
    radio_map = world.site.radio_map
    assert radio_map is not None
    assert radio_map.rows == 25
    assert (radio_map.x_m.min(), radio_map.x_m.max()) == (2.0, 18.0)
    assert len(world.beacons.anchors) == 6
    beacon = world.beacons.anchors[0]
    places = np.array([(beacon.x_m, beacon.y_m, 0.0), (beacon.x_m + 14.0, beacon.y_m, 0.0)])
    loss_db = world.beacons.mean_levels_dbm(places) - world.beacons.shadowing_db(places)
    assert loss_db[0, 0] - loss_db[1, 0] > 15.0


def test_a_phone_tells_steps_and_a_scan_a_second_in_order() -> None:
    world = hall(LAYOUT, np.random.default_rng(1))
    truth = straight_walk(CORNERS_M, pace_mps=1.2)
    told = reported(world, PHONE, truth, np.random.default_rng(2))
    assert told == reported(world, PHONE, truth, np.random.default_rng(2))
    assert [o.time_s for o in told] == sorted(o.time_s for o in told)
    assert sum(isinstance(o, BleScan) for o in told) == 15
    assert sum(isinstance(o, Steps) for o in told) == pytest.approx(18.0 / 0.7, abs=4)
