"""``pharos plan``: the published table, every output, and one line for what cannot be planned."""

import json
import sys
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from app.cli.errors import CommandError
from app.cli.main import cli

CORNERS = [{"x": 0, "y": 0}, {"x": 10, "y": 0}, {"x": 10, "y": 10}, {"x": 0, "y": 10}]
MIDDLES = [{"x": 5, "y": 0}, {"x": 10, "y": 5}, {"x": 5, "y": 10}, {"x": 0, "y": 5}]
ROOM = {
    "width_m": 10,
    "height_m": 10,
    "beacons": CORNERS,
    "noise_db": 5,
    "path_loss_exponent": 1.6,
    "epochs": 28,
    "period_s": 0.07,
    "cell_m": 0.5,
}


def plan(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["plan", *map(str, arguments)], env={"COLUMNS": "200"})


@pytest.fixture
def layout(tmp_path: Path):
    """Return a function that writes a layout file."""

    def write(**fields: object) -> Path:
        path = tmp_path / "layout.json"
        path.write_text(json.dumps({**ROOM, **fields}))
        return path

    return write


@pytest.mark.parametrize(
    ("beacons", "static", "kinematic"),
    [
        (CORNERS, (0.94, 1.05, 1.29), (1.83, 2.05, 2.52)),
        (CORNERS + MIDDLES, (0.44, 0.51, 0.64), (0.85, 1.00, 1.24)),
    ],
)
def test_the_published_table_comes_out(layout, tmp_path, beacons, static, kinematic) -> None:
    out = tmp_path / "out.json"
    result = plan(layout(beacons=beacons), "--json", out)
    assert result.exit_code == 0, result.output
    told = json.loads(out.read_text())
    for name, figures in (("static", static), ("kinematic", kinematic)):
        found = [told[name][key] for key in ("min", "median", "max")]
        assert found == pytest.approx(figures, abs=0.0051)
        grid = told[name]["grid"]
        assert (len(grid), len(grid[0])) == (20, 20)
        assert min(map(min, grid)) == pytest.approx(told[name]["min"], abs=1e-3)
        assert f"{figures[1]:.2f}" in result.output


def test_json_alone_comes_on_stdout(layout) -> None:
    result = plan(layout(), "--json", "-", "--drop-one", "--add", "2", "--cover", "0.8m")
    told = json.loads(result.stdout)
    assert len(told["drop_one"]) == 4
    assert told["add"][0]["x"] == told["add"][0]["y"] == 5.0
    assert told["cover"]["bound_m"] == 0.8
    assert told["cover"]["reached"]
    assert told["cover"]["share_below"] == 1.0
    assert told["cover"]["max"] <= 0.8


def test_what_is_asked_for_in_the_file_is_done_and_an_option_comes_first(layout) -> None:
    told = json.loads(plan(layout(add=1, drop_one=True), "--json", "-").stdout)
    assert (len(told["add"]), len(told["drop_one"]), told["cover"]) == (1, 4, None)
    told = json.loads(plan(layout(add=1), "--json", "-", "--add", "2").stdout)
    assert len(told["add"]) == 2


def test_the_tables_tell_what_to_do(layout) -> None:
    result = plan(layout(), "--drop-one", "--add", "1", "--cover", "0.8")
    assert result.exit_code == 0, result.output
    for words in ("most missed first", "beacon-4", "add-1", "keep 0.8 m everywhere", "cover-1"):
        assert words in result.output
    blind = plan(layout(reach_m=2), "--cover", "0.1m")
    assert "no fix" in blind.output
    assert "do not keep 0.1 m everywhere" in blind.output


def test_a_wall_takes_beacons_out_of_range(layout) -> None:
    wall = {"line": [[5, -1], [5, 11]], "material": "metal"}
    open_room, behind = (
        json.loads(plan(layout(hearing_threshold_dbm=-80, **fields), "--json", "-").stdout)
        for fields in ({}, {"walls": [wall]})
    )
    assert open_room["in_range"]["min"] == 4
    assert behind["in_range"]["max"] == 2
    twice = plan(
        layout(hearing_threshold_dbm=-80, walls=[wall], materials={"metal": 1}), "--json", "-"
    )
    assert json.loads(twice.stdout)["in_range"] == open_room["in_range"]


def test_files_for_a_map_and_for_the_eye(layout, tmp_path: Path) -> None:
    on_globe = [
        {"x": 0, "y": 0, "lat": 52.0, "lon": 13.0},
        {"x": 0, "y": 10, "lat": 52.0001, "lon": 13.0},
    ]
    cells, picture = tmp_path / "cells.geojson", tmp_path / "plan.png"
    path = layout(control_points=on_globe, cell_m=5)
    result = plan(path, "--geojson", cells, "--png", picture)
    assert result.exit_code == 0, result.output
    kinds = [f["properties"]["kind"] for f in json.loads(cells.read_text())["features"]]
    assert kinds == ["cell"] * 4 + ["beacon"] * 4
    with Image.open(picture) as drawn:
        assert drawn.format == "PNG"


def fails(result: Result, said: str) -> None:
    assert isinstance(result.exception, CommandError), result.output
    assert said in str(result.exception)


def test_a_picture_without_matplotlib_is_one_line(layout, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "app.api.planner_picture", None)
    monkeypatch.delitem(sys.modules, "app.api.planner_picture")
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    fails(plan(layout(), "--png", tmp_path / "plan.png"), "install pharos[plots]")


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"width_m": "wide"}, "#/width_m"),
        ({"beacons": [{"x": 1}]}, "#/beacons/0/y"),
        ({"cell_m": 20}, "#/cell_m"),
        ({"colour": "red"}, "#/colour"),
        ({"walls": [{"line": [[0, 0], [1, 1]], "material": "cheese"}]}, "#/walls/0/material"),
    ],
)
def test_a_layout_that_cannot_be_meant_is_pointed_at(layout, fields, said) -> None:
    fails(plan(layout(**fields)), f"layout.json: {said}")


def test_other_refusals_are_one_line(layout, tmp_path: Path) -> None:
    fails(plan(tmp_path / "none.json"), "none.json cannot be read")
    fails(plan(layout(), "--cover", "far"), "--cover 'far'")
    fails(plan(layout(), "--cover", "0m"), "--cover '0m'")
    fails(plan(layout(), "--geojson", tmp_path / "x"), "control_points")
    same = [{"x": 0, "y": 0, "lat": 52.0, "lon": 13.0}] * 2
    path = layout(control_points=same)
    fails(plan(path, "--geojson", tmp_path / "x"), "#/control_points")
    fails(plan(layout(), "--json", tmp_path / "no" / "x"), "x cannot be written")
    (tmp_path / "layout.json").write_text("{")
    fails(plan(tmp_path / "layout.json"), "layout.json: #: Invalid JSON")
