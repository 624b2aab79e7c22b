"""What is derived of maps and sites is made once, and goes with them."""

import gc
import weakref

import numpy as np
import pytest

from app.core import engine
from app.core.derived import derived
from app.core.simulate import walk, warehouse


class Source:
    """Something to derive from."""


def test_a_thing_is_made_once_for_each_source_and_arguments() -> None:
    made: list[tuple[object, int]] = []

    @derived()
    def ones(source: Source, count: int) -> np.ndarray:
        made.append((source, count))
        return np.ones(count)

    one, other = Source(), Source()
    assert ones(one, 2) is ones(one, 2)
    assert ones(one, 3) is not ones(one, 2)
    assert ones(other, 2) is not ones(one, 2)
    assert made == [(one, 2), (one, 3), (other, 2)]


def test_no_more_is_kept_of_a_source_than_was_said() -> None:
    @derived(most=3)
    def ones(_source: Source, count: int) -> np.ndarray:
        return np.ones(count)

    source = Source()
    for count in range(10):
        ones(source, count)
        assert ones.kept_of(source) <= 3
    assert ones(source, 9) is ones(source, 9)


@pytest.mark.parametrize("name", sorted(engine.PROFILES))
def test_a_site_and_its_map_go_with_all_that_a_profile_has_derived_of_them(name: str) -> None:
    world = warehouse(3)
    observations = walk(world, 5, start_s=0.0, duration_s=8.0, imu=False).observations
    params = engine.PROFILES[name].params
    engine.prepare(world.site, params)
    engine.smoothed(observations, world.site, params)
    assert world.site.radio_map is not None
    left = [weakref.ref(world.site), weakref.ref(world.site.radio_map)]
    del world, observations
    gc.collect()
    assert [one() for one in left] == [None, None]
