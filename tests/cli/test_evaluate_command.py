"""``pharos evaluate``: what it takes, refuses and writes."""

import gzip
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from app.cli.errors import CommandError
from app.cli.main import cli
from app.formats.ms2020 import fold_of, trace_id_of, trace_paths


def evaluate(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["evaluate", *map(str, arguments)])


@pytest.fixture
def steps(tmp_path: Path) -> Path:
    """A recording of somebody who stands still and is counted to have taken ten steps."""
    with gzip.open(tmp_path / "ada_hand_1.csv.gz", "wt", encoding="ascii") as file:
        file.writelines(f"{i * 10_000_000},0,0,9.81,0,{min(i, 10)},0\n" for i in range(300))
    return tmp_path


def test_figures_are_written_as_one_object_and_make_a_page(steps: Path, tmp_path: Path) -> None:
    figures, page = tmp_path / "steps.json", tmp_path / "accuracy.md"
    result = evaluate("oxford-steps", steps, "--json", figures)
    assert result.exit_code == 0, result.output
    written = json.loads(figures.read_text())
    assert written["dataset"] == "oxford-steps"
    assert written["profiles"]["steps"]["worst_count_error_share"] == 1.0
    assert evaluate("report", figures, "--out", page).exit_code == 0
    text = page.read_text()
    assert "`pharos evaluate oxford-steps DIR`" in text
    assert "| `worst_count_error_share` | 100.0 % |" in text


def test_json_alone_comes_on_stdout(steps: Path) -> None:
    result = evaluate("oxford-steps", steps, "--json", "-")
    assert json.loads(result.stdout)["profiles"]["steps"]["traces"] == 1


def test_papers_are_told_by_statistic_with_what_they_ought_to_be(tmp_path: Path) -> None:
    figures, page = tmp_path / "papers.json", tmp_path / "accuracy.md"
    result = evaluate("papers", "--seeds", "1", "--only", "grinyak2018", "--json", figures)
    assert result.exit_code == 0, result.output
    written = json.loads(figures.read_text())
    assert written["dataset"] == "papers"
    assert written["command"] == "pharos evaluate papers --seeds 1 --only grinyak2018"
    most = written["profiles"]["grinyak2018"]["corners"]["predicted"]["most_kinematic_sigma_m"]
    assert most["target"] == 2.5
    assert evaluate("report", figures, "--out", page).exit_code == 0
    rows = [line.split(" | ") for line in page.read_text().splitlines() if line.startswith("|")]
    assert rows[0] == ["|", "`median`", "`p10`", "`p90`", "`target` |"]
    told = next(row for row in rows if row[0].endswith("most_kinematic_sigma_m`"))
    assert told[0] == "| `grinyak2018.corners.predicted.most_kinematic_sigma_m`"
    assert told[1] == f"{most['median']:.2f}"
    assert told[-1] == "2.50 |"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("ms2020", ".", "--profile", "magic"), "no profile 'magic'"),
        (("ms2020", "."), "no floor in it"),
        (("growth", "."), "no floor in it"),
        (("growth", ".", "--fold", "2"), "--fold is one of 0, 1"),
        (("oxford-steps", "."), "no step recording"),
        (("kolakowski", "."), "anchors.csv"),
        (("uji-ble", ".", "--zone", "geo"), "anchors.csv"),
        (("ujiindoorloc", "."), "trainingData.csv.gz"),
        (("papers", "--only", "grinyak2018,magic"), "no paper 'magic'"),
        (("report", "nothing.json", "--out", "page.md"), "nothing.json"),
    ],
)
def test_what_cannot_be_evaluated_is_said_in_one_line(
    arguments: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = evaluate(*arguments)
    assert isinstance(result.exception, CommandError)
    assert said in str(result.exception)


def test_real_walks_give_every_figure_and_a_picture_each(shared_data: Path, tmp_path: Path) -> None:
    floor, inside = shared_data / "ms2020" / "site1" / "F2", tmp_path / "mall" / "F2"
    inside.mkdir(parents=True)
    by_fold = {fold: [] for fold in range(4)}
    for path in trace_paths(floor):
        by_fold[fold_of(trace_id_of(path))].append(path)
    walks = [path for fold in range(4) for path in by_fold[fold][: 2 if fold < 2 else 4]]
    drawings = ("floor_info.json", "floor_image.png", "geojson_map.json")
    for path in (*walks, *(floor / name for name in drawings)):
        (inside / path.name).symlink_to(path)
    # It comes first, so it is also what a process would warm up with.
    broken, aimless = [name for name in map(str, range(100)) if fold_of(name) == 0][:2]
    (inside / f"{broken}.txt.xz").write_bytes(b"no xz file")
    scan = "1000\tTYPE_WIFI\tshop\t02:00:5e:00:53:01\t-50\t2412\t1000\n"
    (inside / f"{aimless}.txt").write_text(scan)
    pictures = tmp_path / "pictures"
    options = ("--map-share", "0.5", "--profile", "all", "--plot", pictures, "--json", "-")
    result = evaluate("ms2020", tmp_path / "mall", *options)
    assert result.exit_code == 0, result.output
    assert result.stderr.count(f"F2/{broken}.txt.xz is passed over") == 1
    assert result.stderr.count(f"F2/{aimless}.txt is passed over: no waypoint in it") == 1
    written = json.loads(result.stdout)
    best = written["profiles"]["best"]
    assert best["traces"] == 2
    assert 0.0 < best["mean_error_m"] <= best["p95_error_m"] < 200.0
    assert len(best["coverage95_by_decile"]) == 10
    assert set(best["smoothed"]) == {"mean_error_m", "p95_error_m"}
    drawn = {path.name for path in pictures.rglob("*.png")}
    assert drawn == {"error_cdf.png", *(f"{trace_id_of(path)}.png" for path in by_fold[0][:2])}
    assert "--map-share 0.5" in written["command"]
