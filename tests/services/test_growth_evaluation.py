"""How the walks of a growth evaluation are dealt."""

import numpy as np

from app.formats.ms2020 import Trace, fold_of
from app.services.evaluation.growth import parted
from app.services.evaluation.ms2020 import TUNING


def traces() -> list[Trace]:
    waypoints = np.zeros((2, 3))
    return [
        Trace(f"trace-{i:03d}", floor, (), waypoints, {})
        for i, floor in enumerate(["F1"] * 80 + ["F2"] * 40)
    ]


def ids(some: tuple[Trace, ...]) -> set[str]:
    return {trace.trace_id for trace in some}


def test_a_quarter_is_surveyed_and_another_half_is_traffic_on_every_floor() -> None:
    dealt = parted(traces(), TUNING.mapped, seed=0)
    for floor in ("F1", "F2"):
        there = [
            t for t in traces() if t.floor_name == floor and fold_of(t.trace_id) in TUNING.mapped
        ]
        surveyed, traffic = (
            sum(t.floor_name == floor for t in some) for some in (dealt.surveyed, dealt.traffic)
        )
        assert abs(surveyed - 0.25 * len(there)) <= 0.5
        assert abs(traffic - 0.5 * len(there)) <= 1.0


def test_no_walk_is_dealt_twice_and_none_that_is_asked() -> None:
    dealt = parted(traces(), TUNING.mapped, seed=0)
    assert not ids(dealt.surveyed) & ids(dealt.traffic)
    assert {fold_of(i) for i in ids(dealt.surveyed) | ids(dealt.traffic)} == TUNING.mapped


def test_seeds_deal_otherwise_and_the_order_of_traces_does_not_matter() -> None:
    one, other = (parted(traces(), TUNING.mapped, seed) for seed in (0, 1))
    assert ids(one.surveyed) != ids(other.surveyed)
    assert ids(parted(traces()[::-1], TUNING.mapped, 0).surveyed) == ids(one.surveyed)
