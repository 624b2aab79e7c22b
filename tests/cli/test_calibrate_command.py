"""``pharos calibrate fusion``: what it takes, refuses and prints."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result
from wifi_hall import PACE_MPS, levels_dbm, place_on

from app.cli.errors import CommandError
from app.cli.main import cli

EAST, NORTH = 0.00072, 0.00036
"""About 40 m by 40 m at 60 degrees north."""
CORNERS = [(5.0, 5.0), (35.0, 5.0), (35.0, 35.0), (5.0, 35.0)]
START_MS, SECONDS = 1_000_000, 70


def calibrate(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["calibrate", "fusion", *map(str, arguments)])


def outline() -> dict:
    corners = [[8.0, 60.0], [8.0 + EAST, 60.0], [8.0 + EAST, 60.0 + NORTH], [8.0, 60.0 + NORTH]]
    area = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    feature = {"type": "Feature", "properties": {"floor_num": 1}, "geometry": area}
    return {"type": "FeatureCollection", "features": [feature]}


def trace_lines() -> list[str]:
    lines = []
    for second in range(0, SECONDS, 2):
        time_ms = START_MS + 1000 * second
        x, y, _ = place_on(CORNERS, PACE_MPS * second)
        lines.append(f"{time_ms}\tTYPE_WAYPOINT\t{x}\t{y}")
        for key, level in levels_dbm(x, y).items():
            lines.append(f"{time_ms}\tTYPE_WIFI\tnet\t{key[4:]}\t{level:.0f}\t2412\t{time_ms}")
    return lines


@pytest.fixture
def building(tmp_path: Path) -> Path:
    folder = tmp_path / "hall"
    floor = folder / "F1"
    floor.mkdir(parents=True)
    (floor / "geojson_map.json").write_text(json.dumps(outline()))
    (floor / "floor_info.json").write_text('{"map_info": {"width": 40.0, "height": 40.0}}')
    (floor / "floor_image.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    for name in ("surveyed", "labelled"):
        (floor / f"{name}.txt").write_text("\n".join(trace_lines()))
    return folder


def test_a_walk_without_sensors_cannot_tell_the_weights_and_it_says_so(building: Path) -> None:
    # Without steps V_sensor is V_last itself, and O_sensor is nowhere.
    figures = building / "weights.json"
    result = calibrate(building / "F1" / "labelled.txt", "--json", figures)
    assert result.exit_code == 0, result.output
    told = " ".join(result.output.split())
    assert "do not tell the weights of the speed: those of last and sensors" in told
    assert "do not tell the weights of the heading" in told
    assert "0.38" in told
    written = json.loads(figures.read_text())
    assert written["traces"] == 1
    assert written["before"] == written["after"]


def test_it_needs_waypoints_and_a_building(building: Path, tmp_path: Path) -> None:
    unmarked = building / "F1" / "unmarked.txt"
    lines = [line for line in trace_lines() if "WAYPOINT" not in line]
    unmarked.write_text("\n".join(lines))
    result = calibrate(unmarked)
    assert isinstance(result.exception, CommandError)
    assert "waypoints" in str(result.exception)
    stray = tmp_path / "elsewhere" / "F9" / "walk.txt"
    stray.parent.mkdir(parents=True)
    stray.write_text("\n".join(trace_lines()))
    assert "--building" in str(calibrate(stray).exception)
    assert "'F9'" in str(calibrate(stray, "--building", building).exception)


def test_a_building_with_no_other_walk_has_no_map(building: Path) -> None:
    (building / "F1" / "surveyed.txt").unlink()
    result = calibrate(building / "F1" / "labelled.txt")
    assert "no other walk" in str(result.exception)
