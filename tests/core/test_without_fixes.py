"""What the published systems claim of a phone that no scan corrects any more."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import PROFILES, advance, finish, start
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.params import Params
from app.core.site import Floor, SiteModel
from app.core.types import ImuBlock, Observation, Reading, Steps, TrackPoint, WifiScan

LENGTH_M, PACE_M = 40.0, 0.7
T0, LEFT_S, END_S = 1000.0, 20.0, 70.0
UNTIL_FIXED = ("zhu2018", "tao2016", "blunavi2020")


def levels_dbm(x_m: float) -> dict[str, float]:
    return {f"mac:{i:012x}": -40.0 - 1.5 * abs(x_m - 8.0 * i) for i in range(6)}


def hall() -> SiteModel:
    floor = Floor("f", "Hall", "", 0, 0.0, 0.0, LENGTH_M, 10.0)
    rows = [Fingerprint(0, float(x), 5.0, levels_dbm(x), {}) for x in range(int(LENGTH_M))]
    return SiteModel("hall", 1, (floor,), radio_map=build_radio_map(("f",), rows))


SITE = hall()


def scans() -> Iterator[Observation]:
    """Yield scans of a phone that walks towards one end, then of access points no map knows."""
    for second in np.arange(0.0, LEFT_S, 2.0).tolist():
        heard = levels_dbm(20.0 + second * PACE_M)
        yield WifiScan(T0 + second, tuple(Reading((key,), dbm) for key, dbm in heard.items()))
    for second in np.arange(LEFT_S, END_S, 2.0).tolist():
        yield WifiScan(T0 + second, tuple(Reading((f"mac:f{i:011x}",), -60.0) for i in range(9)))


def steps(begin_s: float, end_s: float) -> Iterator[Observation]:
    return (Steps(T0 + s + 0.5, 1, PACE_M, 0.0) for s in np.arange(begin_s, end_s).tolist())


def points(told: Iterable[Observation], params: Params) -> list[TrackPoint]:
    state, outputs = start(), []
    for observation in sorted([*scans(), *told], key=lambda each: each.time_s):
        state, more = advance(state, observation, SITE, params)
        outputs += more
    outputs += finish(state, SITE, params)
    return [output for output in outputs if isinstance(output, TrackPoint)]


def grown_m2(told: Iterable[Observation], name: str) -> dict[float, tuple[float, float, float]]:
    """Return what each reported covariance is over that of the filter, by the age of its fix."""
    params, told = PROFILES[name].params, list(told)
    alone = replace(params, report=replace(params.report, unfixed_m2ps=0.0))
    grown = {}
    for point, before in zip(points(told, params), points(told, alone), strict=True):
        assert (point.x_m, point.y_m, point.age_s) == (before.x_m, before.y_m, before.age_s)
        xx, xy, yy = np.subtract(point.covariance_m2, before.covariance_m2).tolist()
        grown[point.age_s] = xx, xy, yy
    return grown


@pytest.mark.parametrize("name", UNTIL_FIXED)
def test_a_phone_that_walked_out_of_the_map_is_known_less_each_second(name: str) -> None:
    params = PROFILES[name].params
    track = points(steps(0.0, END_S), params)
    fixed = [p for p in track if p.age_s <= params.report.fused_s]
    old = [p for p in track if p.age_s > params.report.fused_s]
    assert len(old) > 30
    radii_m = [point.radius95_m for point in old]
    assert np.all(np.diff(radii_m) > 0.0)
    assert radii_m[0] > fixed[-1].radius95_m
    # It may be in the building still.
    assert old[-1].x_m - radii_m[-1] < LENGTH_M


@pytest.mark.parametrize("name", UNTIL_FIXED)
def test_while_fixes_come_a_point_is_what_the_filter_says(name: str) -> None:
    grown = grown_m2(steps(0.0, END_S), name)
    young = [grown[age_s] for age_s in grown if age_s <= PROFILES[name].params.report.fused_s]
    assert young
    assert set(young) == {(0.0, 0.0, 0.0)}


@pytest.mark.parametrize("name", UNTIL_FIXED)
def test_the_variance_grows_with_the_time_in_which_the_phone_walked(name: str) -> None:
    params = PROFILES[name].params.report
    walked_s = 12.0
    grown = grown_m2(steps(0.0, LEFT_S + walked_s), name)
    last_m2 = grown[max(grown)]
    ages = [age_s for age_s in grown if age_s > params.fused_s]
    stopped = [age_s for age_s in ages if age_s > walked_s + 10.0]
    assert len(stopped) > 10
    # At rest for long it is where it stopped: what steps tell is that it has not moved.
    assert [grown[age_s] for age_s in stopped] == [pytest.approx(last_m2)] * len(stopped)
    fixed_s = max(p.time_s - p.age_s for p in points([], PROFILES[name].params))
    last_step_s = T0 + LEFT_S + walked_s - 0.5
    expected_m2 = params.unfixed_m2ps * (last_step_s - fixed_s)
    assert last_m2 == pytest.approx((expected_m2, 0.0, expected_m2))


@pytest.mark.parametrize("name", UNTIL_FIXED)
def test_a_phone_without_sensors_may_have_walked_all_the_time(name: str) -> None:
    params = PROFILES[name].params.report
    grown = grown_m2([], name)
    old = {age_s: xx for age_s, (xx, _, _) in grown.items() if age_s > params.fused_s}
    assert len(old) > 30
    for age_s, xx_m2 in old.items():
        assert xx_m2 == pytest.approx(params.unfixed_m2ps * age_s)


@pytest.mark.parametrize("name", UNTIL_FIXED)
def test_a_phone_on_a_table_is_where_it_was(name: str) -> None:
    none, still = np.zeros((50, 3), np.float32), np.tile([0.0, 0.0, 9.81], (50, 1))
    lying = [
        ImuBlock(T0 + s, 50.0, still.astype(np.float32), none, none[:0], np.empty((0, 4)))
        for s in np.arange(0.0, END_S).tolist()
    ]
    assert set(grown_m2(lying, name).values()) == {(0.0, 0.0, 0.0)}
