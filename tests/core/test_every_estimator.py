"""One battery of laws for every estimator of a position from levels of known anchors.

An estimator joins by one line in `ESTIMATORS`: a function from anchors and heard levels to a fix.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.core.engine import advance, finish, start
from app.core.lateration.centroid import CentroidParams, weighted_centroid
from app.core.lateration.windowed import Estimate, estimate
from app.core.params import LaterationParams, Params
from app.core.radio.path_loss import expected_levels, level_model
from app.core.radio.windows import window_of
from app.core.site import Floor, SiteModel
from app.core.types import Anchor, BleScan, Fix, NoFix, NoFixReason, Reading

NOW_S = 500.0
EPOCHS, PERIOD_S = 10, 0.2


class Heard(NamedTuple):
    """Levels in the order in which they came: anchor, time and level of each."""

    anchor_index: np.ndarray
    time_s: np.ndarray
    rssi_dbm: np.ndarray


Estimator = Callable[[tuple[Anchor, ...], Heard], Fix | NoFix]


def lateration(*, kinematic: bool, params: LaterationParams | None = None) -> Estimator:
    def locate(anchors: tuple[Anchor, ...], heard: Heard) -> Fix | NoFix:
        result = estimate(
            window_of(*heard),
            level_model(anchors),
            NOW_S,
            kinematic=kinematic,
            params=params or LaterationParams(),
        )
        return result.fix if isinstance(result, Estimate) else result

    return locate


def centroid(anchors: tuple[Anchor, ...], heard: Heard) -> Fix | NoFix:
    return weighted_centroid(window_of(*heard), level_model(anchors), NOW_S, CentroidParams())


def fused(
    anchors: tuple[Anchor, ...], heard: Heard, x_axis_from_east_rad: float = 0.0
) -> Fix | NoFix:
    """The whole engine, fed with one advertisement scan per epoch."""
    # A plan so large that it says nothing of the place, wherever the layout is moved to.
    floor = Floor("f", "Ground", "b", 0, -1000.0, -1000.0, 2000.0, 2000.0)
    site = SiteModel("s", 1, (floor,), anchors, x_axis_from_east_rad=x_axis_from_east_rad)
    state = start()
    for time_s in sorted(set(heard.time_s.tolist()) | {NOW_S}):
        of_epoch = np.flatnonzero(heard.time_s == time_s)
        readings = tuple(
            Reading(anchors[heard.anchor_index[i]].keys, float(heard.rssi_dbm[i])) for i in of_epoch
        )
        state, _ = advance(state, BleScan(time_s, readings), site, Params())
    last = finish(state, site, Params())[-1]
    if isinstance(last, NoFix):
        return last
    return Fix(last.time_s, last.x_m, last.y_m, last.covariance_m2, last.method, last.used)


ESTIMATORS: dict[str, Estimator] = {
    "weighted centroid": centroid,
    "fused": fused,
    "static": lateration(kinematic=False),
    "kinematic": lateration(kinematic=True),
    "static, unknown offset": lateration(
        kinematic=False, params=LaterationParams(offset_prior_db=6.0)
    ),
    "kinematic, bounded speed": lateration(
        kinematic=True, params=LaterationParams(velocity_prior_mps=1.0)
    ),
}

every_estimator = pytest.mark.parametrize("name", ESTIMATORS)
few_examples = settings(
    max_examples=12, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
seeds = st.integers(0, 10_000)
places = st.tuples(st.floats(2.0, 12.0), st.floats(2.0, 8.0))

LAYOUT = ((0.0, 0.0), (14.0, 1.0), (13.0, 10.0), (1.0, 9.0), (7.0, 11.0), (6.0, -1.0))


def anchors_at(layout) -> tuple[Anchor, ...]:
    return tuple(
        Anchor(f"a{i}", (f"mac:{i:012x}",), "f", x, y, ref_level_dbm=-58.0 - i % 3)
        for i, (x, y) in enumerate(layout)
    )


def heard_at(anchors, place, seed, noise_db=2.0) -> Heard:
    rng, n = np.random.default_rng(seed), len(anchors)
    levels = expected_levels(level_model(anchors), np.array([place[0]]), np.array([place[1]]))
    noisy = levels + rng.normal(0.0, noise_db, (EPOCHS, n))
    times_s = NOW_S - PERIOD_S * np.arange(EPOCHS)[::-1]
    return Heard(np.tile(np.arange(n), EPOCHS), np.repeat(times_s, n), noisy.reshape(-1))


def located(name, anchors, heard) -> Fix:
    fix = ESTIMATORS[name](anchors, heard)
    assert isinstance(fix, Fix)
    return fix


def covariance(fix: Fix) -> np.ndarray:
    xx, xy, yy = fix.covariance_m2
    return np.array([[xx, xy], [xy, yy]])


def moved(anchors, turn_rad, shift) -> tuple[Anchor, ...]:
    rotation = turning(turn_rad)
    places_ = [rotation @ (a.x_m, a.y_m) + shift for a in anchors]
    return tuple(
        replace(a, x_m=float(p[0]), y_m=float(p[1])) for a, p in zip(anchors, places_, strict=True)
    )


def turning(turn_rad) -> np.ndarray:
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    return np.array([[c, -s], [s, c]])


def close(first: Fix, second: Fix, *, tolerance_m=0.02) -> None:
    assert (first.x_m, first.y_m) == pytest.approx((second.x_m, second.y_m), abs=tolerance_m)
    scale = np.trace(covariance(first))
    np.testing.assert_allclose(covariance(first), covariance(second), atol=0.03 * scale)


@every_estimator
@few_examples
@given(place=places, seed=seeds)
def test_order_of_readings_is_irrelevant(name, place, seed):
    anchors = anchors_at(LAYOUT)
    heard = heard_at(anchors, place, seed)
    order = np.random.default_rng(seed).permutation(len(heard.time_s))
    assert located(name, anchors, Heard(*(part[order] for part in heard))) == located(
        name, anchors, heard
    )


@every_estimator
@few_examples
@given(place=places, seed=seeds)
def test_order_of_anchors_is_irrelevant(name, place, seed):
    anchors = anchors_at(LAYOUT)
    heard = heard_at(anchors, place, seed)
    order = np.random.default_rng(seed).permutation(len(anchors))
    position = np.argsort(order)
    renamed = heard._replace(anchor_index=position[heard.anchor_index])
    shuffled = tuple(anchors[i] for i in order)
    close(located(name, shuffled, renamed), located(name, anchors, heard))


@every_estimator
@few_examples
@given(
    place=places,
    seed=seeds,
    turn_rad=st.floats(-3.1, 3.1),
    shift=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
)
def test_a_moved_layout_carries_the_fix_along(name, place, seed, turn_rad, shift):
    anchors = anchors_at(LAYOUT)
    heard = heard_at(anchors, place, seed)
    fix = located(name, anchors, heard)
    if name == "fused":
        # The particles are drawn along east, so the engine is told where that is now.
        turned = fused(moved(anchors, turn_rad, shift), heard, -turn_rad)
        assert isinstance(turned, Fix)
    else:
        turned = located(name, moved(anchors, turn_rad, shift), heard)
    rotation = turning(turn_rad)
    x, y = rotation @ (fix.x_m, fix.y_m) + shift
    carried = rotation @ covariance(fix) @ rotation.T
    expected = (float(carried[0, 0]), float(carried[0, 1]), float(carried[1, 1]))
    close(replace(fix, x_m=float(x), y_m=float(y), covariance_m2=expected), turned)
    if fix.velocity_mps is not None:
        assert turned.velocity_mps == pytest.approx(rotation @ fix.velocity_mps, abs=0.02)


@every_estimator
@few_examples
@given(place=places, seed=seeds)
def test_covariance_is_positive_and_the_fix_is_finite(name, place, seed):
    anchors = anchors_at(LAYOUT)
    fix = located(name, anchors, heard_at(anchors, place, seed))
    assert np.isfinite((fix.x_m, fix.y_m, *fix.covariance_m2)).all()
    assert np.linalg.eigvalsh(covariance(fix)).min() > 0.0


@every_estimator
@few_examples
@given(place=places, seed=seeds)
def test_inputs_are_untouched_and_the_answer_is_always_the_same(name, place, seed):
    anchors = anchors_at(LAYOUT)
    heard = heard_at(anchors, place, seed)
    before = [part.copy() for part in heard]
    for part in heard:
        part.flags.writeable = False
    first = located(name, anchors, heard)
    assert located(name, anchors, heard) == first
    for part, kept in zip(heard, before, strict=True):
        np.testing.assert_array_equal(part, kept)


@every_estimator
@few_examples
@given(along=st.floats(1.0, 14.0), beside=st.floats(-5.0, 5.0), seed=seeds)
def test_anchors_in_a_row_do_not_lie(name, along, beside, seed):
    anchors = anchors_at(((0.0, 0.0), (5.0, 0.0), (10.0, 0.0), (15.0, 0.0)))
    result = ESTIMATORS[name](anchors, heard_at(anchors, (along, beside), seed))
    if isinstance(result, NoFix):
        assert result.reason is NoFixReason.DEGENERATE_GEOMETRY
        return
    for side in (beside, -beside):
        error = np.array((result.x_m - along, result.y_m - side))
        assert error @ np.linalg.solve(covariance(result), error) < 16.0


@every_estimator
def test_too_few_anchors_are_no_fix(name):
    anchors = anchors_at(LAYOUT)
    nothing = Heard(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
    assert ESTIMATORS[name](anchors, nothing) == NoFix(NOW_S, NoFixReason.NOTHING_HEARD)
    pair = heard_at(anchors[:2], (4.0, 4.0), 1)
    assert ESTIMATORS[name](anchors, pair) == NoFix(NOW_S, NoFixReason.TOO_FEW_TRANSMITTERS)


@every_estimator
@few_examples
@given(place=places, seed=seeds)
def test_the_fix_is_where_its_covariance_says(name, place, seed):
    anchors = anchors_at(LAYOUT)
    heard = heard_at(anchors, place, seed, noise_db=5.0)
    fix = located(name, anchors, heard)
    error = np.array((fix.x_m - place[0], fix.y_m - place[1]))
    assert error @ np.linalg.solve(covariance(fix), error) < 20.0
