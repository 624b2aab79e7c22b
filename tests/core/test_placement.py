"""Where to add beacons, and how few keep a bound: against trying everything."""

from itertools import combinations

import numpy as np
import pytest
from lateration_room import CORNERS, anchors_at

from app.core.lateration.placement import Choices, Cover, best_additions, fewest_for_bound
from app.core.lateration.planning import FixRule, Ground, information, predict
from app.core.lateration.predicted import Schedule, cell_centres
from app.core.radio.path_loss import LevelModel, level_model
from app.core.radio.walls import HearingParams, heard

SCHEDULE = Schedule()
RULE = FixRule(SCHEDULE.position_factor(kinematic=False))
NOTHING_YET = np.zeros((100, 4))
COARSE = [(x, y) for x in (0.0, 5.0, 10.0) for y in (0.0, 5.0, 10.0)]
EVEN = [(x, y) for x in np.linspace(0, 10, 6) for y in np.linspace(0, 10, 6)]


def room(walls=()) -> Ground:
    x_m, y_m = cell_centres(10.0, 10.0, 1.0)
    return Ground(x_m.ravel(), y_m.ravel(), np.array(walls, dtype=np.float64).reshape(-1, 5))


def choices(places, hearing=None) -> Choices:
    return Choices(level_model(anchors_at(places)), hearing or HearingParams(), RULE)


def static_m(ground: Ground, places, hearing=None) -> np.ndarray:
    model = level_model(anchors_at(places))
    return predict(ground, model, SCHEDULE, hearing or HearingParams()).static_m


def present(ground: Ground, model: LevelModel, hearing=None) -> np.ndarray:
    walls, hearing = ground.walls, hearing or HearingParams()
    return information(model, ground, heard(model, ground.x_m, ground.y_m, walls, hearing))


def test_each_next_beacon_is_the_one_that_trying_all_finds() -> None:
    ground, hung = room(), list(CORNERS[:3])
    epoch = present(ground, level_model(anchors_at(hung)))
    chosen = best_additions(ground, epoch, choices(EVEN), 3)
    for found in chosen:
        mean_m2 = [np.mean(static_m(ground, [*hung, place]) ** 2) for place in EVEN]
        assert mean_m2[found] == pytest.approx(min(mean_m2), rel=1e-9)
        hung.append(EVEN[found])
    assert len(chosen) == len(set(chosen)) == 3


def test_from_nothing_the_first_beacons_make_a_fix_everywhere() -> None:
    chosen = best_additions(room(), NOTHING_YET, choices(EVEN), 3)
    assert np.isfinite(static_m(room(), [EVEN[i] for i in chosen])).all()


def test_a_beacon_goes_to_the_side_of_the_wall_where_none_is_heard() -> None:
    ground = room(walls=[(5.0, -1.0, 5.0, 11.0, 60.0)])
    left = level_model(anchors_at(((1.0, 1.0), (1.0, 9.0), (4.0, 5.0))))
    chosen = best_additions(ground, present(ground, left), choices(EVEN), 3)
    assert len(chosen) == 3
    assert all(EVEN[i][0] > 5.0 for i in chosen)


def test_no_beacon_is_added_where_none_would_be_heard() -> None:
    deaf = HearingParams(threshold_dbm=0.0)
    assert best_additions(room(), NOTHING_YET, choices(EVEN, deaf), 4) == ()
    assert best_additions(room(), NOTHING_YET, choices([]), 4) == ()
    assert len(best_additions(room(), NOTHING_YET, choices(COARSE[:2]), 4)) == 2


@pytest.mark.parametrize("bound_m", [2.5, 1.5, 1.0, 0.8])
def test_a_bound_takes_as_few_beacons_as_trying_all_finds(bound_m: float) -> None:
    ground = room()
    cover = fewest_for_bound(ground, NOTHING_YET, choices(COARSE), bound_m, 9)
    assert cover.reached
    assert static_m(ground, [COARSE[i] for i in cover.chosen]).max() <= bound_m
    fewer = combinations(COARSE, len(cover.chosen) - 1)
    assert not [p for p in fewer if len(p) > 1 and static_m(ground, p).max() <= bound_m]


def test_beacons_that_hang_already_count_for_a_bound() -> None:
    ground = room()
    corners = level_model(anchors_at(CORNERS))
    epoch = present(ground, corners)
    assert fewest_for_bound(ground, epoch, choices(EVEN), 1.5, 9) == Cover((), reached=True)
    cover = fewest_for_bound(ground, epoch, choices(EVEN), 0.8, 9)
    alone = fewest_for_bound(ground, NOTHING_YET, choices(EVEN), 0.8, 9)
    assert cover.reached
    assert 0 < len(cover.chosen) < len(alone.chosen)
    hung = [*CORNERS, *(EVEN[i] for i in cover.chosen)]
    assert static_m(ground, hung).max() <= 0.8


def test_a_bound_that_cannot_be_kept_is_said_so() -> None:
    hearing = HearingParams(reach_m=3.0)
    cover = fewest_for_bound(room(), NOTHING_YET, choices(COARSE, hearing), 0.1, 9)
    assert not cover.reached
    few = fewest_for_bound(room(), NOTHING_YET, choices(EVEN), 0.3, 4)
    assert not few.reached
    assert len(few.chosen) == 4
