"""Docs say what the code says."""

import re
import tomllib
from pathlib import Path

import pytest
from pydantic.fields import FieldInfo

from app.config import Settings
from app.formats import beacons_csv, fingerprints_csv

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def rows_of(page: str, heading: str) -> list[list[str]]:
    """Return the cells of the first table after a heading, its head left out."""
    text = (DOCS / page).read_text(encoding="utf-8").partition(heading)[2]
    lines = re.search(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert lines is not None
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in lines[0].splitlines()][
        2:
    ]


def shown(field: FieldInfo) -> str:
    default = field.default
    if default is None:
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if default == ():
        return "`[]`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def test_every_setting_is_documented_as_it_is() -> None:
    expected = [
        [f"`PHAROS_{name.upper()}`", shown(field), field.description]
        for name, field in Settings.model_fields.items()
    ]
    assert rows_of("running.md", "## Settings") == expected


@pytest.mark.parametrize(
    ("heading", "columns"),
    [
        (
            "csv beacons",
            {
                *beacons_csv.COLUMNS,
                *beacons_csv.HEALTH_COLUMNS,
                *beacons_csv.KEY_COLUMNS,
            },
        ),
        ("csv fingerprints", {*fingerprints_csv.NEEDED, *fingerprints_csv.OPTIONAL}),
    ],
)
def test_every_column_of_a_table_is_documented(heading: str, columns: set[str]) -> None:
    cells = " ".join(row[0] for row in rows_of("formats.md", heading))
    assert set(re.findall(r"`(\w+)`", cells)) == columns


@pytest.mark.parametrize("page", sorted(path.name for path in DOCS.glob("*.md")))
def test_every_file_that_docs_name_is_there(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:app|tests|migrations)/[\w/.-]+)`", text))
    assert not [name for name in named if not (ROOT / name).exists()]


def indented(text: str, depth: int) -> set[str]:
    """Return the folders and modules of a drawn tree at a depth of indentation."""
    return set(re.findall(rf"^ {{{depth}}}(\w+)(?:/|\.py)\s", text, re.MULTILINE))


def test_the_architecture_page_draws_the_tree_that_there_is() -> None:
    tree = (DOCS / "architecture.md").read_text(encoding="utf-8").split("```")[1]
    app = {p.stem for p in (ROOT / "app").iterdir() if p.is_dir() or p.suffix == ".py"}
    assert indented(tree, 2) == app - {"__init__", "__pycache__"}
    core = {p.name for p in (ROOT / "app" / "core").iterdir() if p.is_dir()}
    assert indented(tree, 4) == core - {"__pycache__"}


def test_the_architecture_page_shows_the_layers_of_the_contracts() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for contract in contracts["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers":
            assert "```\n" + "\n".join(contract["layers"]) + "\n```" in text, contract["name"]
