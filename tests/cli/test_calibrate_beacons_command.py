"""``pharos calibrate beacons``: tables in, report and table out."""

import json
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli.errors import CommandError
from app.cli.main import cli
from app.formats.beacons_csv import read_beacons_csv

CORNERS = {"a": (0.0, 0.0, -52.0), "b": (20.0, 0.0, -64.0), "c": (10.0, 12.0, -58.0)}


@pytest.fixture
def tables(tmp_path: Path) -> tuple[Path, Path]:
    beacons, levels = tmp_path / "beacons.csv", tmp_path / "levels.csv"
    beacons.write_text(
        "beacon_id,kind,floor_id,x,y,mac\n"
        + "".join(
            f"{name},ble,f,{x},{y},a4c13800000{i}\n"
            for i, (name, (x, y, _)) in enumerate(CORNERS.items())
        )
    )
    rows = [
        f"{x},{y},{level - 24.0 * math.log10(max(math.hypot(bx - x, by - y), 0.3)):.2f},{name}"
        for x in range(1, 20, 2)
        for y in range(1, 12, 2)
        for name, (bx, by, level) in CORNERS.items()
    ]
    levels.write_text("x,y,rssi_dbm,beacon_id\n" + "\n".join(rows))
    return beacons, levels


def test_it_writes_a_table_to_import_and_tells_the_gain(tables: tuple[Path, Path]) -> None:
    out, report = tables[0].with_name("new.csv"), tables[0].with_name("report.json")
    arguments = ["calibrate", "beacons", *tables, "--out", out, "--json", report]
    result = CliRunner().invoke(cli, list(map(str, arguments)))
    assert result.exit_code == 0, result.output
    fitted = {row.fields["beacon_id"]: row.fields for row in read_beacons_csv(out.read_text())}
    for name, (_, _, level) in CORNERS.items():
        assert fitted[name]["ref_level_dbm"] == pytest.approx(level, abs=0.5)
        assert fitted[name]["path_loss_exponent"] == pytest.approx(2.4, abs=0.1)
    told = json.loads(report.read_text())
    assert told["after"]["mean_error_m"] < told["before"]["mean_error_m"]
    assert "Mean error at places left out" in result.output


@pytest.mark.parametrize("text", ["x,y\n1,2\n", "x,y,rssi_dbm,key\n1,2,nan,mac:a4c138000001\n"])
def test_a_wrong_table_is_named(tables: tuple[Path, Path], text: str) -> None:
    tables[1].write_text(text)
    result = CliRunner().invoke(cli, ["calibrate", "beacons", *map(str, tables)])
    assert isinstance(result.exception, CommandError)
    assert "levels.csv" in str(result.exception)
