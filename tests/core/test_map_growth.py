"""The map grows from use: half of a warehouse surveyed, the other half walked by phones."""

import math
from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import PROFILES, advance, finish, smoothed, start
from app.core.engine.growing import (
    FinishedSession,
    GrowingParams,
    GrownSession,
    condensed,
    grow,
    grown_map,
)
from app.core.fingerprint.growth import GROWN, GrowthParams, candidates
from app.core.fingerprint.growth_effect import growth_effect
from app.core.fingerprint.query import first_of
from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.core.site import SiteModel
from app.core.types import (
    BleScan,
    ImuBlock,
    Method,
    MotionMode,
    Observation,
    Reading,
    TrackPoint,
    Used,
    WifiScan,
)

PARAMS = PROFILES["best"].params
START_S, DURATION_S = 1_790_000_000.0, 90.0
TRAFFIC, ASKED = range(100, 116), range(200, 204)
GROWING = GrowingParams()


def half_surveyed(world: Warehouse) -> SiteModel:
    """Return the warehouse as a server knows it that lacks beacons and the survey's right half."""
    radio_map = world.site.radio_map
    left = radio_map.of_rows(radio_map.x_m < 40.0)
    return replace(world.site, anchors=(), radio_map=left)


def scans_and_steps(walked: SimulatedWalk) -> tuple[Observation, ...]:
    """Return what tells the place here: beacons would be as good a map in the half without one."""
    return tuple(o for o in walked.observations if not isinstance(o, BleScan))


@pytest.fixture(scope="module")
def world() -> Warehouse:
    return warehouse(seed=5)


@pytest.fixture(scope="module")
def site(world: Warehouse) -> SiteModel:
    return half_surveyed(world)


@pytest.fixture(scope="module")
def sessions(world: Warehouse) -> list[FinishedSession]:
    return [
        FinishedSession(f"s{seed}", scans_and_steps(walk(world, seed, START_S, DURATION_S)))
        for seed in TRAFFIC
    ]


@pytest.fixture(scope="module")
def joining(sessions: list[FinishedSession], site: SiteModel) -> tuple[GrownSession, ...]:
    return grow(sessions, site, PARAMS, GROWING)


def mean_error_m(world: Warehouse, site: SiteModel) -> float:
    errors: list[float] = []
    for seed in ASKED:
        asked = walk(world, seed, START_S, DURATION_S)
        errors += causal_errors_m(asked, site)
    return float(np.mean(errors))


def causal_errors_m(asked: SimulatedWalk, site: SiteModel) -> list[float]:
    state, told = start(), []
    for observation in scans_and_steps(asked):
        state, outputs = advance(state, observation, site, PARAMS)
        told.extend(outputs)
    told.extend(finish(state, site, PARAMS))
    points = [point for point in told if isinstance(point, TrackPoint)]
    places = [asked.truth_at(point.time_s) for point in points]
    return [
        math.hypot(point.x_m - place.x_m, point.y_m - place.y_m)
        for point, place in zip(points, places, strict=True)
    ]


def test_walks_through_the_half_that_nobody_surveyed_are_followed_better(
    world: Warehouse, site: SiteModel, joining: tuple[GrownSession, ...]
) -> None:
    grown = replace(site, radio_map=grown_map(site.radio_map, joining, site))
    before_m, after_m = mean_error_m(world, site), mean_error_m(world, grown)
    assert after_m < 0.8 * before_m, (before_m, after_m)


def test_rounds_grow_it_better_than_one(
    world: Warehouse,
    site: SiteModel,
    sessions: list[FinishedSession],
    joining: tuple[GrownSession, ...],
) -> None:
    once = grow(sessions, site, PARAMS, replace(GROWING, max_mean_sorensen=(1.0,)))
    errors_m = [
        mean_error_m(world, replace(site, radio_map=grown_map(site.radio_map, found, site)))
        for found in (once, joining)
    ]
    assert errors_m[1] < 0.95 * errors_m[0], errors_m


def test_it_grows_into_the_half_that_nobody_surveyed(joining: tuple[GrownSession, ...]) -> None:
    x_m = [c.fingerprint.x_m for session in joining for c in session.candidates]
    assert max(x_m) > 55.0


def test_the_order_of_sessions_does_not_matter(
    sessions: list[FinishedSession], site: SiteModel
) -> None:
    few = replace(GROWING, max_mean_sorensen=(1.0,), min_floor_share=0.0)
    one, other = (grow(order, site, PARAMS, few) for order in (sessions[:3], sessions[2::-1]))
    assert one == other[::-1]
    assert len(one) == 3


def test_what_is_strange_to_the_map_does_not_join(
    sessions: list[FinishedSession], site: SiteModel
) -> None:
    assert grow(sessions[:2], site, PARAMS, GrowingParams(max_mean_sorensen=(0.0,))) == ()


def test_surveyed_rows_stay_and_grown_ones_can_be_told_from_them(
    site: SiteModel, joining: tuple[GrownSession, ...]
) -> None:
    grown = grown_map(site.radio_map, joining, site)
    rows = site.radio_map.rows
    assert grown.survey_walks[:rows] == site.radio_map.survey_walks
    assert grown.x_m[:rows].tolist() == site.radio_map.x_m.tolist()
    assert {walk[: len(GROWN)] for walk in grown.survey_walks[rows:]} == {GROWN}


def test_the_effect_is_told_of_surveyed_rows_alone(
    site: SiteModel, joining: tuple[GrownSession, ...]
) -> None:
    grown = grown_map(site.radio_map, joining, site)
    effect = growth_effect(site.radio_map, grown, PARAMS.match)
    assert 0 < effect.scans <= site.radio_map.rows
    same = growth_effect(site.radio_map, site.radio_map, PARAMS.match)
    assert same.before_m == same.after_m == pytest.approx(effect.before_m)


def test_a_session_without_inertial_samples_is_placed_alike(
    world: Warehouse, site: SiteModel
) -> None:
    raw = walk(world, 300, START_S, 60.0, imu=True).observations
    assert any(isinstance(o, ImuBlock) for o in raw)
    kept = condensed(raw, site, PARAMS)
    assert not any(isinstance(o, ImuBlock) for o in kept)
    one, other = ({p.time_s: p for p in smoothed(told, site, PARAMS)} for told in (raw, kept))
    apart_m = [
        math.hypot(one[t].x_m - other[t].x_m, one[t].y_m - other[t].y_m)
        for t in one.keys() & other.keys()
    ]
    assert len(apart_m) > 50
    assert np.mean(apart_m) < 1.0


def point(time_s: float, x_m: float, **fields: object) -> TrackPoint:
    told = TrackPoint(
        *(time_s, "f0", x_m, 2.0, (1.0, 0.0, 1.0), 12.0, 0.0, None),
        *(MotionMode.STILL, Method.FUSED, 1.0, Used(), 0.0),
    )
    return replace(told, **fields)


def rows_of(track: list[TrackPoint], *scan_s: float) -> list[tuple[float, float]]:
    readings = tuple(Reading((f"mac:{i}",), -60.0) for i in range(4))
    scans = [WifiScan(time_s, readings) for time_s in scan_s]
    rule = first_of({}), PARAMS.match
    rows = candidates(scans, track, ("f0",), "w", rule, GrowthParams())
    return [(row.time_s, row.fingerprint.x_m) for row in rows]


def test_a_scan_lies_on_the_line_between_two_points_of_the_track() -> None:
    track = [point(10.0, 0.0), point(11.0, 1.0)]
    assert rows_of(track, 9.5, 10.25, 11.0, 11.5) == [(10.25, 0.25), (11.0, 1.0)]


@pytest.mark.parametrize(
    "fields",
    [{"radius95_m": 30.0}, {"floor_confidence": 0.5}, {"floor_id": "elsewhere"}, {"time_s": 15.0}],
    ids=["wide radius", "doubtful floor", "another floor", "long gap"],
)
def test_a_scan_whose_place_is_doubtful_is_refused(fields: dict[str, object]) -> None:
    track = [point(10.0, 0.0), replace(point(11.0, 1.0), **fields)]
    assert rows_of(track, 10.5) == []
