"""The engine on simulated walks over the stairs and in the lift: the floor follows."""

from dataclasses import dataclass

import pytest

from app.core import engine
from app.core.params import Params
from app.core.simulate import ConnectorKind, SimulatedWalk, Warehouse, walk, warehouse
from app.core.types import TrackPoint

START_S = 1_790_000_000.0
RIGHT_AGAIN_WITHIN_S = 5.0
WALKS = 8


@dataclass(frozen=True)
class Followed:
    """A walk and the points that the engine made of it."""

    walk: SimulatedWalk
    points: tuple[TrackPoint, ...]


@pytest.fixture(scope="module")
def world() -> Warehouse:
    return warehouse(seed=11)


@pytest.fixture(scope="module")
def followed(world: Warehouse) -> list[Followed]:
    return [_follow(world, walk(world, seed, START_S, 300.0)) for seed in range(WALKS)]


def _follow(world: Warehouse, simulated: SimulatedWalk) -> Followed:
    params, state, outputs = Params(), engine.start(), []
    for observation in simulated.observations:
        state, told = engine.advance(state, observation, world.site, params)
        outputs.extend(told)
    outputs.extend(engine.finish(state, world.site, params))
    return Followed(simulated, tuple(o for o in outputs if isinstance(o, TrackPoint)))


def test_the_floor_is_right_again_soon_after_the_stairs_and_the_lift(
    world: Warehouse, followed: list[Followed]
) -> None:
    passages = set()
    for one in followed:
        for change in one.walk.truth.floor_changes:
            passages.add(change.kind)
            settled_s = change.end_s + RIGHT_AGAIN_WITHIN_S
            for point in one.points:
                floor_index = one.walk.truth_at(point.time_s).floor_index
                if settled_s <= point.time_s <= settled_s + 20.0:
                    reported = world.site.floor_index(point.floor_id)
                    assert reported == floor_index, (change, point.time_s - change.end_s)
    assert passages == set(ConnectorKind)


def test_the_floor_is_right_nearly_always(world: Warehouse, followed: list[Followed]) -> None:
    right = [
        world.site.floor_index(point.floor_id) == one.walk.truth_at(point.time_s).floor_index
        for one in followed
        for point in one.points
    ]
    # What is left is the middle of the stairs, where either floor is an answer.
    assert sum(right) / len(right) > 0.96
    assert len(right) > 0.95 * 300 * WALKS
