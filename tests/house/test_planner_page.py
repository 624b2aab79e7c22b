"""docs/planner.md: its example runs and prints what it says, its tables are those of the code."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.api.planner_schema import FloorPlan, Layout
from app.cli.main import cli
from app.formats.floor_map import MATERIALS_DB
from app.services import planning

PAGE = (Path(__file__).parents[2] / "docs" / "planner.md").read_text(encoding="utf-8")


def rows_after(head: str) -> list[list[str]]:
    """Return the cells of the table that begins with a head."""
    table = PAGE.partition(f"| {head} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table]


def test_the_example_prints_what_the_page_shows(tmp_path: Path) -> None:
    layout = tmp_path / "layout.json"
    layout.write_text(re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)[0])
    command = re.findall(r"^pharos plan layout\.json (.*)$", PAGE, re.MULTILINE)[0].split()
    outputs = {"plan.json": tmp_path / "plan.json", "plan.png": tmp_path / "plan.png"}
    options = [str(outputs.get(word, word)) for word in command]
    result = CliRunner().invoke(cli, ["plan", str(layout), *options], env={"COLUMNS": "100"})
    assert result.exit_code == 0, result.output
    printed = [line.strip() for line in result.output.splitlines()]
    shown = [block for block in PAGE.split("```")[1::2] if "━" in block]
    assert len(shown) == 2
    for line in "".join(shown).splitlines():
        assert not line or line.strip() in printed, line
    assert len(json.loads(outputs["plan.json"].read_text())["cover"]["beacons"]) == 2
    assert outputs["plan.png"].stat().st_size > 1000


def test_every_field_is_described_with_its_default() -> None:
    fields = {**Layout.model_fields, **FloorPlan.model_fields}
    described: dict[str, str] = {}
    for names, default, _ in rows_after("field"):
        defaults = default.split(", ") if "," in names else [default]
        for i, name in enumerate(re.findall(r"`(\w+)`", names)):
            described[name] = defaults[min(i, len(defaults) - 1)].strip("`")
    assert set(described) == set(fields)
    for name, field in fields.items():
        if field.is_required():
            assert described[name] == "needed"
        elif isinstance(field.default, bool):
            assert described[name] == str(field.default).lower()
        elif isinstance(field.default, str):
            assert described[name] == field.default
        elif field.default is not None:
            assert float(described[name]) == field.default


def test_every_material_is_described() -> None:
    described = {name.strip("`"): float(loss) for name, loss in rows_after("material")}
    assert described == MATERIALS_DB


@pytest.mark.parametrize("limit", [planning.MAX_CELLS, planning.MAX_WALLS, planning.MAX_CANDIDATES])
def test_the_limits_are_those_of_the_code(limit: int) -> None:
    assert f"{limit:,}" in PAGE
