"""A plan may lie on the globe at any angle: tracks turn with it, and the world stays as it is."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from app.api.fix import fix_json
from app.core import engine
from app.core.geometry import wrap_angle
from app.core.georeference import ControlPoint, Georeference, fit_georeference
from app.core.params import Params
from app.core.simulate import walk, warehouse
from app.core.site import Floor, SiteModel
from app.core.types import ImuBlock, Observation, Pedometer, Steps, TrackPoint

# A raster of walkable floor is cut along the plan's axes: it would not turn exactly.
WORLD = warehouse(seed=1)
WORLD = replace(
    WORLD,
    site=replace(
        WORLD.site, floors=tuple(replace(floor, walkable=None) for floor in WORLD.site.floors)
    ),
)
CORNERS = ((0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0))


def turned(x_m, y_m, turn_rad):
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    return x_m * cos - y_m * sin, x_m * sin + y_m * cos


def at_corners(frame) -> Georeference:
    """Return the georeference of a frame in which the warehouse's corners lie at these places."""
    return fit_georeference(
        [
            ControlPoint(*place, 48.0 + y_m / 111_000.0, 11.0 + x_m / 74_000.0)
            for place, (x_m, y_m) in zip(frame, CORNERS, strict=True)
        ]
    )


def on_the_globe(site: SiteModel, georeference: Georeference) -> SiteModel:
    return replace(site, x_axis_from_east_rad=georeference.x_axis_from_east_rad)


def without_walls(site: SiteModel) -> SiteModel:
    return replace(site, floors=tuple(replace(floor, walls=()) for floor in site.floors))


def turned_floor(floor: Floor, turn_rad: float) -> Floor:
    walls = tuple(
        replace(wall, x0_m=x0, y0_m=y0, x1_m=x1, y1_m=y1)
        for wall in floor.walls
        for x0, y0 in [turned(wall.x0_m, wall.y0_m, turn_rad)]
        for x1, y1 in [turned(wall.x1_m, wall.y1_m, turn_rad)]
    )
    right, high = floor.x0_m + floor.width_m, floor.y0_m + floor.height_m
    corners = [turned(x, y, turn_rad) for x in (floor.x0_m, right) for y in (floor.y0_m, high)]
    (left, low), (right, high) = np.min(corners, axis=0), np.max(corners, axis=0)
    return replace(
        floor, x0_m=left, y0_m=low, width_m=right - left, height_m=high - low, walls=walls
    )


def rotated(site: SiteModel, turn_rad: float) -> SiteModel:
    anchors = []
    for anchor in site.anchors:
        x_m, y_m = turned(anchor.x_m, anchor.y_m, turn_rad)
        anchors.append(replace(anchor, x_m=x_m, y_m=y_m))
    radio_map = site.radio_map
    if radio_map is not None:
        x_m, y_m = turned(radio_map.x_m, radio_map.y_m, turn_rad)
        radio_map = replace(radio_map, x_m=x_m, y_m=y_m)
    floors = tuple(turned_floor(floor, turn_rad) for floor in site.floors)
    return replace(site, anchors=tuple(anchors), radio_map=radio_map, floors=floors)


def track(site: SiteModel, observations: Sequence[Observation]) -> list[TrackPoint]:
    state, outputs = engine.start(), []
    for observation in observations:
        state, more = engine.advance(state, observation, site, Params())
        outputs += more
    outputs += engine.finish(state, site, Params())
    return [output for output in outputs if isinstance(output, TrackPoint)]


def phones_own_steps() -> Sequence[Observation]:
    return walk(WORLD, seed=4, start_s=0.0, duration_s=40.0).observations


def rotation_vector() -> Sequence[Observation]:
    observations = walk(WORLD, seed=4, start_s=0.0, duration_s=40.0, imu=True).observations
    assert any(isinstance(o, ImuBlock) and len(o.quat_wxyz) for o in observations)
    return [o for o in observations if not isinstance(o, Steps)]


def pedometer_beside_a_rotation_vector() -> Sequence[Observation]:
    intervals = [Pedometer(5.0 * i, 5.0 * i + 4.9, 8) for i in range(1, 8)]
    return sorted([*rotation_vector(), *intervals], key=engine.order_key)


@pytest.mark.parametrize(
    "heard", [phones_own_steps, rotation_vector, pedometer_beside_a_rotation_vector]
)
@pytest.mark.parametrize(
    ("site", "turn_rad"),
    [
        (replace(WORLD.site, anchors=()), 0.7),
        # Lateration searches a grid along the axes: only a quarter turn leaves it as it is. Walls
        # lie exactly on that of their losses, so rounding decides which side of them a cell is.
        (without_walls(replace(WORLD.site, radio_map=None)), math.pi / 2.0),
    ],
    ids=["radio map", "anchors"],
)
def test_a_turned_plan_turns_the_track_and_leaves_it_where_it_is_on_the_globe(
    heard, site, turn_rad
):
    plain = at_corners(CORNERS)
    tilted = at_corners([turned(*corner, turn_rad) for corner in CORNERS])
    before = track(on_the_globe(site, plain), heard())
    after = track(on_the_globe(rotated(site, turn_rad), tilted), heard())
    assert len(before) == len(after) > 30
    headings = 0
    for a, b in zip(before, after, strict=True):
        assert (b.x_m, b.y_m) == pytest.approx(turned(a.x_m, a.y_m, turn_rad), abs=1e-6)
        of_a = fix_json("phone", "site", a, plain)
        of_b = fix_json("phone", "site", b, tilted)
        assert of_b["lat"] == pytest.approx(of_a["lat"], abs=1e-11)
        assert of_b["lon"] == pytest.approx(of_a["lon"], abs=1e-11)
        if a.heading_rad is None or b.heading_rad is None:
            assert of_a["heading_deg"] is of_b["heading_deg"] is None
        else:
            headings += 1
            assert abs(wrap_angle(b.heading_rad - a.heading_rad - turn_rad)) < 1e-6
            apart_deg = (of_b["heading_deg"] - of_a["heading_deg"] + 180.0) % 360.0 - 180.0
            assert abs(apart_deg) <= 0.0101
    assert headings > 10


def test_without_a_georeference_the_plan_is_north_up():
    point = track(WORLD.site, phones_own_steps())[-1]
    east = replace(point, heading_rad=0.0)
    assert fix_json("phone", "site", east)["heading_deg"] == 90.0
    assert WORLD.site.x_axis_from_east_rad == 0.0


def test_the_x_axis_of_a_frame_that_looks_north():
    frame = [(y_m, -x_m) for x_m, y_m in CORNERS]
    georeference = at_corners(frame)
    assert georeference.x_axis_from_east_rad == pytest.approx(math.pi / 2.0, abs=1e-9)
    point = replace(track(WORLD.site, phones_own_steps())[-1], heading_rad=0.0)
    assert fix_json("phone", "site", point, georeference)["heading_deg"] == 0.0
