"""What scans say of anchors: dead, moved or duplicated, and that few words blame nobody."""

import numpy as np
import pytest

from app.core.lateration.faults import (
    DEAD,
    DUPLICATED,
    MOVED,
    Fault,
    FaultParams,
    at_fault,
    heard_evidence,
    judged,
    silent_evidence,
)
from app.core.lateration.two_levels import two_levels
from app.core.radio.windows import Window

PARAMS = FaultParams()
HERE, NEWS = np.ones(1), 0.5


def heard(residual_db: float, told: float = 0.0) -> np.ndarray:
    """Return the evidence of a level, and of readings that speak so much for two transmitters."""
    found = heard_evidence(np.array([[residual_db]]), HERE, np.array([5.0]), PARAMS)[0]
    found[DUPLICATED] += told
    return found


def silent(above_db: float) -> np.ndarray:
    return silent_evidence(np.array([[above_db]]), HERE, np.array([5.0]), PARAMS)[0]


def after(*scans: np.ndarray) -> dict[str, tuple[float, ...]]:
    odds: dict[str, tuple[float, ...]] = {}
    for evidence in scans:
        odds = judged(odds, {"a": (NEWS * evidence).tolist()}, 1.0, PARAMS)
    return odds


@pytest.mark.parametrize(
    ("scans", "fault"),
    [
        ([silent(20.0)] * 5, Fault.DEAD),
        ([heard(-20.0)] * 5, Fault.MOVED),
        ([silent(20.0)] * 5 + [heard(20.0)] * 5, Fault.MOVED),
        ([heard(0.0, told=3.0)] * 5, Fault.DUPLICATED),
        ([heard(20.0, told=3.0)] * 5, Fault.DUPLICATED),
        ([heard(20.0)] * 2, None),
        ([heard(20.0)] * 8, Fault.MOVED),
    ],
)
def test_each_fault_is_told_by_what_it_does(scans: list[np.ndarray], fault: Fault | None) -> None:
    assert at_fault(after(*scans), 8, PARAMS) == {"a": fault}


def test_what_a_healthy_anchor_does_blames_it_for_nothing() -> None:
    assert after(*[heard(0.0)] * 20) == {}
    assert after(*[silent(-20.0)] * 20) == {}
    assert at_fault(after(heard(40.0)), 8, PARAMS) == {}
    assert at_fault(after(silent(40.0)), 8, PARAMS) == {}


def test_a_second_transmitter_makes_louder_never_quieter() -> None:
    assert heard(20.0)[DUPLICATED] > 3.0 > 0.0 > heard(-20.0)[DUPLICATED]
    assert heard(20.0)[MOVED] == pytest.approx(heard(-20.0)[MOVED])
    assert heard(0.0)[DEAD] < -3.0


def test_a_level_that_fits_somewhere_near_is_no_evidence() -> None:
    near = np.array([[20.0], [0.0]])
    told = heard_evidence(near, np.full(2, 0.5), np.array([5.0]), PARAMS)
    assert told[0, MOVED] < 0.0 < heard(20.0)[MOVED]


def test_faults_are_forgotten_and_mended_anchors_believed_again() -> None:
    bad = after(*[heard(-20.0)] * 10)
    assert at_fault(bad, 8, PARAMS) == {"a": Fault.MOVED}
    assert at_fault(judged(bad, {}, 5 * PARAMS.memory_s, PARAMS), 8, PARAMS) == {}
    mended = bad
    for _ in range(15):
        mended = judged(mended, {"a": heard(0.0).tolist()}, 1.0, PARAMS)
    assert at_fault(mended, 8, PARAMS) == {}


def test_where_most_anchors_seem_wrong_it_is_the_place() -> None:
    odds = dict.fromkeys("abcd", (2.0, -4.0, -4.0))
    assert at_fault(odds, 8, PARAMS) == {}
    assert at_fault(odds, 12, PARAMS) == dict.fromkeys("abcd", Fault.DEAD)


def window_of_levels(*levels_dbm: list[float]) -> Window:
    count = [len(levels) for levels in levels_dbm]
    index = np.repeat(np.arange(len(levels_dbm)), count)
    time_s = np.concatenate([np.arange(n, dtype=float) for n in count])
    return Window(index, time_s, np.concatenate(levels_dbm))


STEADY = [-70.0, -72.0, -69.0, -71.0, -73.0, -70.0]


def test_levels_that_alternate_are_two_transmitters() -> None:
    both = [-60.0, -78.0, -62.0, -80.0, -59.0, -79.0]
    told = two_levels(window_of_levels(STEADY, both, STEADY), 3)
    assert told[1] > 2.0
    assert max(told[0], told[2]) <= 0.0


@pytest.mark.parametrize(
    "levels_dbm",
    [
        [-60.0, -62.0, -59.0, -79.0, -80.0, -78.0],
        [-60.0, -62.0, -85.0, -61.0, -59.0, -60.0],
        [-60.0, -80.0, -60.0],
        [-80.0, -75.0, -70.0, -65.0, -60.0, -55.0],
    ],
    ids=["a corner was turned", "one deep fade", "too few", "approached"],
)
def test_a_corner_a_fade_and_an_approach_are_none(levels_dbm: list[float]) -> None:
    assert two_levels(window_of_levels(STEADY, levels_dbm, STEADY), 3)[1] <= 0.0


def test_where_all_levels_flutter_nobody_is_blamed() -> None:
    flutter = [-60.0, -78.0, -62.0, -80.0, -59.0, -79.0]
    assert two_levels(window_of_levels(flutter, flutter, flutter), 3).max() <= 0.0
