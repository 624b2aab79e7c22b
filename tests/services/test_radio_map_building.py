"""A radio map is built of surveys: placed, cleaned, without wanderers, filled as asked for."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.geometry import Walkable
from app.core.site import Floor
from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.core.types import Reading, WifiScan
from app.services.errors import AppError
from app.services.radio_map_building import BuildOptions, Placing, built_map

PLAIN = BuildOptions(virtual=False)
ACCESS_POINTS = {f"mac:00000000000{i}": (10.0 * i, 5.0) for i in range(5)}
WALKABLE = Walkable(0.0, 0.0, 1.0, np.zeros((11, 41)))
FLOORS = (
    Floor("f0", "0", "hall", 0, 0.0, 0.0, 40.0, 10.0, walkable=WALKABLE),
    Floor("f1", "1", "hall", 1, 0.0, 0.0, 40.0, 10.0),
)


def levels(x_m: float, y_m: float) -> dict[str, float]:
    return {
        key: -40.0 - 25.0 * math.log10(max(math.hypot(x_m - ax, y_m - ay), 1.0))
        for key, (ax, ay) in ACCESS_POINTS.items()
    }


def walk(
    name: str = "w", floor_id: str = "f0", begin_s: float = 0.0, y_m: float = 5.0
) -> SurveyWalk:
    """Return a walk of 20 m that rests for 20 s half-way; waypoints only at its ends."""
    times = begin_s + np.concatenate([np.arange(10.0), 30.0 + np.arange(11.0)])
    x_m = np.arange(21.0)
    scans = tuple(
        WifiScan(t, tuple(Reading((k,), u) for k, u in levels(x, y_m).items()))
        for t, x in zip(times.tolist(), x_m.tolist(), strict=True)
    )
    strides = np.column_stack([times[1:], np.full(20, 0.8), np.full(20, 1.0)])
    waypoints = np.array([(times[0], 0.0, y_m), (times[-1], 20.0, y_m)])
    return SurveyWalk(name, floor_id, scans, strides, waypoints)


def points(levels_dbm: list[float], x_m: float = 30.0) -> list[SurveyPoint]:
    key = next(iter(ACCESS_POINTS))
    return [
        SurveyPoint("p", "f0", x_m, 5.0, {key: level}, {}, "", float(i))
        for i, level in enumerate(levels_dbm)
    ]


def test_scans_of_a_walk_are_where_the_strides_say_or_on_the_straight_line() -> None:
    smoothed = built_map([walk()], FLOORS, PLAIN)
    straight = built_map([walk()], FLOORS, replace(PLAIN, placing=Placing.STRAIGHT))
    assert np.abs(smoothed.radio_map.x_m - np.arange(21.0)).max() < 0.5
    assert np.abs(straight.radio_map.x_m - np.arange(21.0)).max() > 4.0
    assert (smoothed.report.walks, smoothed.report.dead_reckoned_walks) == (1, 1)
    assert (straight.report.walks, straight.report.dead_reckoned_walks) == (1, 0)
    assert (smoothed.report.scans, smoothed.report.placed_scans) == (21, 21)


def test_a_reference_point_is_cleaned_or_kept_scan_by_scan() -> None:
    scans = points([-60.0, -60.5, -59.5, -60.0, -85.0])
    cleaned = built_map(scans, FLOORS, PLAIN)
    kept = built_map(scans, FLOORS, replace(PLAIN, cleaning=False))
    assert cleaned.radio_map.rssi_dbm.tolist() == pytest.approx([-60.0], abs=0.5)
    assert cleaned.statistics is not None
    assert cleaned.statistics.count.tolist() == [5]
    assert (cleaned.report.point_scans, cleaned.report.reference_points) == (5, 1)
    assert (kept.radio_map.rows, kept.statistics) == (5, None)


def test_virtual_fingerprints_only_where_asked_for() -> None:
    walks = [walk("w"), walk("v", begin_s=1_000.0, y_m=2.0)]
    plain, filled = built_map(walks, FLOORS, PLAIN), built_map(walks, FLOORS, BuildOptions())
    assert VIRTUAL_WALK not in plain.radio_map.survey_walks
    virtual = filled.radio_map.survey_walks.count(VIRTUAL_WALK)
    assert virtual == filled.report.virtual_fingerprints > 0
    assert filled.radio_map.rows == plain.radio_map.rows + virtual


def test_a_hotspot_that_moved_is_kept_out_and_named() -> None:
    def with_hotspot(of: SurveyWalk, at: slice) -> SurveyWalk:
        carried = Reading(("mac:aaaaaaaaaaaa",), -30.0)
        loud = {scan.time_s for scan in of.scans[at]}
        scans = tuple(
            replace(s, readings=(*s.readings, carried)) if s.time_s in loud else s for s in of.scans
        )
        return replace(of, scans=scans)

    walks = [
        with_hotspot(walk("w"), slice(0, 4)),
        with_hotspot(walk("v", begin_s=5_000.0), slice(17, 21)),
    ]
    built = built_map(walks, FLOORS, PLAIN)
    assert "mac:aaaaaaaaaaaa" not in built.radio_map.column_by_key
    (out,) = built.report.document()["kept_out"]
    assert (out["key"], out["reason"]) == ("mac:aaaaaaaaaaaa", "moved")
    assert built.radio_map.rows == 42


def test_a_walk_that_was_uploaded_twice_counts_once() -> None:
    once = built_map([walk("w"), walk("v", begin_s=1_000.0)], FLOORS, PLAIN)
    again = built_map(
        [walk("w"), walk("v", begin_s=1_000.0), walk("w"), walk("w", begin_s=2_000.0)],
        FLOORS,
        PLAIN,
    )
    assert (once.report.walks, once.report.repeated_walks) == (2, 0)
    assert (again.report.walks, again.report.repeated_walks) == (3, 1)
    assert again.radio_map.rows == once.radio_map.rows + 21


def test_the_order_of_the_surveys_does_not_matter() -> None:
    surveyed: list[Surveyed] = [
        walk("w"),
        walk("v", begin_s=1_000.0),
        walk("u", "f1"),
        *points([-60.0, -61.0]),
    ]
    expected = built_map(surveyed, FLOORS, BuildOptions())
    random.Random(3).shuffle(surveyed)
    other = built_map(surveyed, FLOORS, BuildOptions())
    assert other.report == expected.report
    assert other.radio_map.transmitters == expected.radio_map.transmitters
    assert other.radio_map.rssi_dbm.tobytes() == expected.radio_map.rssi_dbm.tobytes()


def test_what_lies_on_no_floor_of_the_site_is_left_out_and_counted() -> None:
    built = built_map([walk(), walk("v", "gone")], FLOORS, PLAIN)
    assert (built.report.other_floors, set(built.radio_map.survey_walks)) == (1, {"w"})
    with pytest.raises(AppError, match="no scan of these surveys can be placed"):
        built_map([walk("v", "gone")], FLOORS, PLAIN)


def test_scans_long_before_the_first_waypoint_have_no_place() -> None:
    late = walk()
    late = replace(late, waypoints=np.array([(5.0, 5.0, 5.0), *late.waypoints[1:]]))
    report = built_map([late], FLOORS, PLAIN).report
    assert (report.scans, report.placed_scans) == (21, 17)
