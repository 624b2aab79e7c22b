"""Bad beacons along walks through simulated warehouses: named in time, and healthy ones not.

A part of what ``python tests/accuracy/faulty_walks.py`` prints, which says what is counted: one
beacon in eight is bad, a third of them dead, a third moved by 15 m, a third duplicated.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from faulty_walks import KINDS, NAMED_S, Followed, follow

from app.core.simulate import warehouse

WORLDS, WALKERS = (200, 201, 202), range(100, 105)


@dataclass(frozen=True, slots=True)
class Walks:
    """The same walks among healthy beacons, and with one in eight bad."""

    healthy: list[Followed]
    bad: list[Followed]


@pytest.fixture(scope="module")
def walks() -> Walks:
    healthy, bad = [], []
    for world in map(warehouse, WORLDS):
        healthy += [follow(world, n, ()) for n in WALKERS]
        bad += [follow(world, n, KINDS) for n in WALKERS]
    return Walks(healthy, bad)


def error_m(walks: list[Followed]) -> float:
    return float(np.nanmean(np.concatenate([w.error_m for w in walks])))


def test_healthy_beacons_are_rarely_blamed(walks: Walks) -> None:
    for some in (walks.healthy, walks.bad):
        assert sum(w.false_seconds() for w in some) <= 0.07 * sum(len(w.said) for w in some)


@pytest.mark.parametrize(("kind", "share"), [("dead", 0.9), ("moved", 0.6), ("duplicated", 0.6)])
def test_bad_beacons_are_named_within_ten_seconds(walks: Walks, kind: str, share: float) -> None:
    delays = [delay for w in walks.bad for one, delay, _ in w.delays() if one == kind]
    assert len(delays) >= 4
    assert np.mean([delay <= NAMED_S for delay in delays]) >= share


def test_the_kind_told_is_mostly_right(walks: Walks) -> None:
    right = [right for w in walks.bad for _, delay, right in w.delays() if np.isfinite(delay)]
    assert np.mean(right) >= 0.75


def test_one_bad_beacon_in_eight_costs_at_most_three_tenths(walks: Walks) -> None:
    assert error_m(walks.bad) <= 1.3 * error_m(walks.healthy)
