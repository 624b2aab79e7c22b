"""A phone outside the plan that still hears its beacons: no fix, or a radius that reaches it."""

import math
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.core.engine import PROFILES, advance, finish, start
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.lateration.outside import (
    Outside,
    OutsideParams,
    offset_on_plan,
    places_around,
    reaching_radius95_m,
)
from app.core.lateration.posterior import PhoneOffset
from app.core.site import Floor, SiteModel
from app.core.types import (
    Anchor,
    BleScan,
    NoFix,
    NoFixReason,
    Output,
    Reading,
    TrackPoint,
    WifiScan,
)

WIDTH_M, HEIGHT_M = 20.0, 10.0
FLOOR = Floor("f", "F", "", 0, 0.0, 0.0, WIDTH_M, HEIGHT_M)
BEACONS_M = ((0.0, 0.0), (20.0, 0.0), (20.0, 10.0), (0.0, 10.0), (10.0, 5.0))
ANCHORS = tuple(Anchor(f"a{i}", (f"mac:{i}",), "f", x, y) for i, (x, y) in enumerate(BEACONS_M))
SITE = SiteModel("s", 1, (FLOOR,), ANCHORS)
PARAMS = PROFILES["best"].params
NOISE_DB, DEAF_DBM, FIRST_S, SECONDS = 3.0, -100.0, 5, 15
MIDDLE = (10.0, 5.0)
PARAMS_OUT = OutsideParams()

Place = tuple[float, float]


def scan_at(place: Place, time_s: float, rng: np.random.Generator, offset_db: float) -> BleScan:
    readings = []
    for anchor, beacon in zip(ANCHORS, BEACONS_M, strict=True):
        distance_m = max(math.dist(place, beacon), 0.5)
        level_dbm = -59.0 - 20.0 * math.log10(distance_m) + offset_db + rng.normal(0.0, NOISE_DB)
        if level_dbm > DEAF_DBM:
            readings.append(Reading(anchor.keys, level_dbm))
    return BleScan(time_s, tuple(readings))


def told(places: Iterable[Place], seed: int, offset_db: float = 0.0) -> Iterator[Output]:
    """What is said each second of a phone that goes along these places."""
    rng, state = np.random.default_rng(seed), start()
    for second, place in enumerate(places):
        state, _ = advance(state, scan_at(place, 1000.0 + second, rng, offset_db), SITE, PARAMS)
        yield finish(state, SITE, PARAMS)[-1]


def told_at(place: Place, seeds: int, offset_db: float = 0.0) -> list[Output]:
    """The same of phones that stay, after their first seconds."""
    return [
        output
        for seed in range(seeds)
        for output in list(told([place] * SECONDS, seed, offset_db))[FIRST_S:]
    ]


def is_honest(output: Output, place: Place) -> bool:
    if isinstance(output, NoFix):
        return output.reason is NoFixReason.OUTSIDE_MAPPED_AREA
    return math.dist((output.x_m, output.y_m), place) <= output.radius95_m


def no_fix_share(outputs: list[Output]) -> float:
    return float(np.mean([isinstance(output, NoFix) for output in outputs]))


@pytest.mark.parametrize(
    ("beyond_m", "share"), [(5.0, 0.8), (10.0, 0.8), (20.0, 0.9), (40.0, 0.9), (80.0, 0.9)]
)
def test_a_phone_outside_is_not_told_a_confident_wrong_place(beyond_m: float, share: float) -> None:
    place = (WIDTH_M + beyond_m, 5.0)
    assert np.mean([is_honest(output, place) for output in told_at(place, 8)]) >= share


def test_far_outside_there_is_no_fix_and_the_reason_says_so() -> None:
    outputs = told_at((WIDTH_M + 80.0, 5.0), 4)
    assert no_fix_share(outputs) > 0.9
    reasons = {output.reason for output in outputs if isinstance(output, NoFix)}
    assert reasons == {NoFixReason.OUTSIDE_MAPPED_AREA}


@pytest.mark.parametrize("offset_db", [-10.0, 0.0, 10.0])
def test_inside_every_phone_has_a_fix(offset_db: float) -> None:
    rng = np.random.default_rng(int(offset_db) + 100)
    for place in rng.uniform((0.0, 0.0), (WIDTH_M, HEIGHT_M), (8, 2)).tolist():
        outputs = told_at((place[0], place[1]), 1, offset_db)
        assert no_fix_share(outputs) == 0.0
        assert np.mean([is_honest(output, (place[0], place[1])) for output in outputs]) > 0.9


def test_a_usual_phone_inside_keeps_a_usual_radius() -> None:
    radii_m = [output.radius95_m for output in told_at(MIDDLE, 4) if isinstance(output, TrackPoint)]
    assert len(radii_m) == 4 * (SECONDS - FIRST_S)
    assert np.mean(radii_m) < 7.0


def test_whoever_comes_in_is_placed_within_seconds() -> None:
    """What is learned of a phone's offset outside must not make it wait inside."""
    away = [(WIDTH_M + 60.0, 5.0)] * 20
    way_in = [(float(x), 5.0) for x in np.arange(WIDTH_M + 60.0, 10.0, -1.3)]
    for seed in range(4):
        outputs = list(told([*away, *way_in, *[MIDDLE] * 20], seed))
        assert no_fix_share(outputs[15:40]) > 0.9
        for output in outputs[-15:]:
            assert isinstance(output, TrackPoint)
            assert math.dist((output.x_m, output.y_m), MIDDLE) < 3.0


def test_whoever_leaves_loses_the_fix() -> None:
    way_out = [(float(x), 5.0) for x in np.arange(10.0, WIDTH_M + 40.0, 1.3)]
    for seed in range(4):
        outputs = list(told([*[MIDDLE] * 15, *way_out, *[(WIDTH_M + 40.0, 5.0)] * 5], seed))
        assert no_fix_share(outputs[:20]) == 0.0
        assert no_fix_share(outputs[-10:]) == 1.0


def test_wifi_that_tells_the_place_outweighs_faint_beacons() -> None:
    """Bags and bodies take from beacons, too: a fingerprint of the place is worth more."""
    wifi_dbm = {f"w{i}": -60.0 - i for i in range(6)}
    rows = [Fingerprint(0, x, 5.0, wifi_dbm, {}) for x in (9.0, 10.0, 11.0)]
    site = SiteModel("s", 1, (FLOOR,), ANCHORS, build_radio_map(("f",), rows))
    wifi = tuple(Reading((key,), level) for key, level in wifi_dbm.items())
    rng, state = np.random.default_rng(1), start()
    for second in range(SECONDS):
        time_s = 1000.0 + second
        faint = scan_at((WIDTH_M + 80.0, 5.0), time_s, rng, 0.0)
        state, _ = advance(state, faint, site, PARAMS)
        state, _ = advance(state, WifiScan(time_s + 0.5, wifi), site, PARAMS)
    state, _ = advance(state, scan_at((WIDTH_M + 80.0, 5.0), 1015.0, rng, 0.0), site, PARAMS)
    output = finish(state, site, PARAMS)[-1]
    assert isinstance(output, TrackPoint)
    assert math.dist((output.x_m, output.y_m), MIDDLE) < 2.0


def outside_with(probability: float) -> Outside:
    places_m = places_around(np.array([0.0, 0.0, WIDTH_M, HEIGHT_M]))
    weight = np.full(len(places_m), 1.0 / len(places_m))
    return Outside(0.0, math.log(probability / (1.0 - probability)), places_m, weight)


@given(st.floats(0.001, 0.95), st.floats(0.5, 20.0))
def test_the_reaching_radius_holds_95_percent_of_both(probability: float, radius_m: float) -> None:
    outside, place = outside_with(probability), np.array(MIDDLE)
    reach_m = reaching_radius95_m(radius_m, place, outside)

    def held(to_m: float) -> float:
        apart_m = np.hypot(*(outside.places_m - place).T)
        on_plan = 1.0 - 0.05 ** ((to_m / radius_m) ** 2)
        beyond = float(outside.weight[apart_m <= to_m].sum())
        return (1.0 - probability) * on_plan + probability * beyond

    assert reach_m >= radius_m * 0.999
    assert held(reach_m * 1.0001) >= 0.95 - 1e-6
    assert held(reach_m * 0.999) <= 0.95


def test_places_around_a_plan_are_outside_it_on_all_sides() -> None:
    x, y = places_around(np.array([5.0, -10.0, 25.0, 0.0])).T
    assert not np.any((x > 5.0) & (x < 25.0) & (y > -10.0) & (y < 0.0))
    assert {x.min() < -100.0, x.max() > 100.0, y.min() < -100.0, y.max() > 100.0} == {True}


def test_an_offset_learned_outside_is_forgotten_and_one_learned_inside_is_kept() -> None:
    learned, at_large = PhoneOffset(-14.0, 1.0), PhoneOffset(0.0, 5.0)
    kept = offset_on_plan(learned, at_large, outside_with(0.5), 1.0, PARAMS_OUT)
    assert kept == learned
    forgot = offset_on_plan(learned, at_large, outside_with(0.97), 3600.0, PARAMS_OUT)
    assert forgot.mean_db == pytest.approx(0.0, abs=1.0)
    assert forgot.sigma_db == pytest.approx(5.0, abs=1.0)
