"""An anchor that died, was moved or doubled while somebody walks by is found and left out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from app.core.changed import changed
from app.core.engine import advance, start
from app.core.engine.doubting import fault_of_heard, left_out
from app.core.engine.state import SessionState
from app.core.lateration.faults import MOVED, Fault, FaultParams
from app.core.lateration.posterior import USUAL_FAULT, local_levels
from app.core.params import Params
from app.core.radio.path_loss import expected_levels, level_model
from app.core.site import Floor, SiteModel
from app.core.types import Anchor, BleScan, Reading, Steps, TrackPoint

SPACING_M, NOISE_DB = 6.0, 3.0
ANCHORS = tuple(
    Anchor(f"a{i}", (f"mac:{i:012x}",), "hall", x, y)
    for i, (x, y) in enumerate(
        (x, y) for x in np.arange(0, 25, SPACING_M) for y in (0.0, 6.0, 12.0)
    )
)
SITE = SiteModel("s", 1, (Floor("hall", "Hall", "b", 0, 0.0, 0.0, 24.0, 12.0),), ANCHORS)
BAD, BROKEN_S, FOUND_S, END_S = 7, 20, 30, 45
"""The anchor in the middle of the hall breaks while somebody walks about it."""

PRIOR = FaultParams().prior_log_odds_ratio

Levels = np.ndarray
Break = Callable[[Levels, Levels], Levels]


def none(levels_dbm: Levels, far_dbm: Levels) -> Levels:
    return levels_dbm


def died(levels_dbm: Levels, far_dbm: Levels) -> Levels:
    return np.full_like(levels_dbm, -np.inf)


def moved(levels_dbm: Levels, far_dbm: Levels) -> Levels:
    return far_dbm


def doubled(levels_dbm: Levels, far_dbm: Levels) -> Levels:
    return np.concatenate([levels_dbm, far_dbm])


def place_at(second: float) -> tuple[float, float]:
    """To and fro along an aisle of 8 m that passes the anchor which is to break."""
    way_m = (1.3 * second) % 16.0
    return 8.0 + (way_m if way_m < 8.0 else 16.0 - way_m), 4.0


def walked(fault: Break, seed: int) -> tuple[list[tuple[float, dict[str, Fault | None]]], float]:
    """Return who is left out after each scan, and the mean error once a fault is to be found."""
    rng, state = np.random.default_rng(seed), start()
    model = level_model(ANCHORS)
    far = level_model((Anchor("far", ("mac:ff",), "hall", 12.0, 21.0),))
    named, errors_m = [], []
    for second in range(1, END_S + 1):
        x, y = place_at(second)
        bx, by = place_at(second - 1)
        steps = Steps(
            second - 0.4, 2, step_length_m=0.65, heading_rad=float(np.arctan2(y - by, x - bx))
        )
        state, outputs = advance(state, steps, SITE, Params())
        at = np.array([x]), np.array([y])
        levels = expected_levels(model, *at)[0] + rng.normal(0.0, NOISE_DB, (2, len(ANCHORS)))
        far_dbm = expected_levels(far, *at)[0] + rng.normal(0.0, NOISE_DB, 2)
        of_bad = (fault if second > BROKEN_S else none)(levels[:, BAD], far_dbm)
        heard = [(i, u) for i in range(len(ANCHORS)) if i != BAD for u in levels[:, i]]
        heard += [(BAD, u) for u in of_bad if np.isfinite(u)]
        readings = tuple(Reading(ANCHORS[i].keys, float(u)) for i, u in heard)
        state, _ = advance(state, BleScan(float(second), readings), SITE, Params())
        named.append((float(second), state.evidence.left_out))
        errors_m += [
            float(np.hypot(o.x_m - place_at(o.time_s)[0], o.y_m - place_at(o.time_s)[1]))
            for o in outputs
            if isinstance(o, TrackPoint) and o.time_s > FOUND_S
        ]
    return named, float(np.mean(errors_m))


@pytest.mark.parametrize(
    ("fault", "kind"),
    [(died, Fault.DEAD), (moved, Fault.MOVED), (doubled, Fault.DUPLICATED)],
)
def test_a_fault_is_named_within_ten_seconds_and_nobody_else_is(fault: Break, kind: Fault) -> None:
    for seed in range(3):
        named, _ = walked(fault, seed)
        before = [out for time_s, out in named if time_s <= BROKEN_S]
        assert not any(before)
        assert dict(named)[FOUND_S] == {f"a{BAD}": kind}


@pytest.mark.parametrize("fault", [died, moved, doubled])
def test_once_found_the_error_stays_within_1_3_of_the_healthy_one(fault: Break) -> None:
    seeds = range(5)
    healthy_m = np.mean([walked(none, seed)[1] for seed in seeds])
    assert np.mean([walked(fault, seed)[1] for seed in seeds]) <= 1.3 * healthy_m


def heard_at_once(offset_db: float, scans_per_s: int, seconds: int) -> SessionState:
    """Return the state of a phone that stands in the hall while one anchor errs by so much."""
    rng, state, model = np.random.default_rng(5), start(), level_model(ANCHORS)
    levels = expected_levels(model, np.array([11.0]), np.array([4.0]))[0]
    levels[BAD] += offset_db
    for scan in range(1, seconds * scans_per_s + 1):
        told = levels + rng.normal(0.0, NOISE_DB, len(ANCHORS))
        heard = zip(ANCHORS, told.tolist(), strict=True)
        readings = tuple(Reading(anchor.keys, level) for anchor, level in heard)
        state, _ = advance(state, BleScan(scan / scans_per_s, readings), SITE, Params())
    return state


def test_scanning_more_often_is_no_more_evidence() -> None:
    often, seldom = (
        heard_at_once(-20.0, rate, seconds=5).lateration.fault_log_odds[f"a{BAD}"][MOVED]
        for rate in (5, 1)
    )
    assert PRIOR < seldom < often
    # The first scan has nothing to be newer than, which costs it a second at one a second.
    assert often - PRIOR <= 1.6 * (seldom - PRIOR)


def test_an_anchor_counts_fully_until_it_is_left_out_and_then_not_at_all() -> None:
    state = heard_at_once(0.0, 1, seconds=5)
    levels = local_levels(state.window, level_model(ANCHORS), correlation=0.5)
    suspected, named = ((-2.5, moved, -4.0) for moved in (-0.5, 0.5))
    weights = []
    for odds in ((PRIOR,) * 3, suspected, named):
        memory = replace(state.lateration, fault_log_odds={f"a{BAD}": odds})
        out = left_out(changed(state, lateration=memory), len(ANCHORS))
        weights.append(fault_of_heard(out, levels, SITE)[BAD])
    assert weights[0] == weights[1] == USUAL_FAULT
    assert weights[2] > 0.95
