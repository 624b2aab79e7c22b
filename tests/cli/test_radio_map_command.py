"""The commands of docs/radio-maps.md as they stand there, and what the others say."""

import io
import json
import re
import shlex
import zipfile
from pathlib import Path

import numpy as np
import pytest
from command_line import Pharos

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.survey import SurveyPoint
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import RadioMapOrigin, list_radio_maps, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.surveys import (
    StoredSurvey,
    add_records,
    begin_survey,
    complete_survey,
    points_row,
)

DOCS = Path(__file__).parents[2] / "docs"
KEYS = [f"mac:00000000000{i}" for i in range(4)]


def blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def levels(x_m: float) -> dict[str, float]:
    return {key: -45.0 - 1.5 * abs(x_m - 6.0 * i) for i, key in enumerate(KEYS)}


@pytest.fixture
def active(database_url: str) -> str:
    """Return the id of the active map of a hall with a survey of eight points, five scans each."""
    points = [
        SurveyPoint(
            f"p{i}", "hall-f1", 2.5 * i, 5.0, levels(2.5 * i + 0.1 * j), {}, f"p{i}", 1.0 * j
        )
        for i in range(8)
        for j in range(5)
    ]
    rows = [Fingerprint(0, 2.0 * i, 5.0, levels(2.0 * i), {}, f"w{i}") for i in range(8)]
    database = Database(database_url)
    database.write_now(lambda c: insert_site(c, StoredSite("hall", "Hall", 0.0)))
    floor = StoredFloor("hall-f1", "hall", "F1", 0, 20.0, 10.0)
    database.write_now(lambda c: insert_floor(c, floor))
    survey = StoredSurvey("points", "hall", "Points", "test", 0.0)
    database.write_now(lambda c: begin_survey(c, survey))
    database.write_now(lambda c: add_records(c, "points", [points_row(points)]))
    database.write_now(lambda c: complete_survey(c, survey))
    old, origin = build_radio_map(("hall-f1",), rows), RadioMapOrigin("old", 0.0)
    stored = database.write_now(lambda c: save_radio_map(c, "hall", old, origin, activate=True))
    database.close_now()
    return stored.radio_map_id


def test_the_documented_commands_do_what_the_page_says(
    pharos: Pharos,
    active: str,
    database_url: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    names, said = {"ACTIVE": active}, {}
    (block,) = blocks("radio-maps.md", "sh")
    for line in block.splitlines():
        name, command = re.fullmatch(r"(?:(\w+)=\$\()?pharos ([^)]*)\)?", line).groups()
        words = [re.sub(r"\$(\w+)", lambda m: names[m[1]], word) for word in shlex.split(command)]
        code, out, err = pharos(*words)
        assert code == 0, (line, err)
        said[words[1]] = out + err
        if name is not None:
            names[name] = out.strip()
    assert "8 reference points" in said["build"]
    assert f"{names['MAP']}, version 2, is active" in said["activate"]
    assert f"{active}, version 1, is active" in said["rollback"]
    assert "places: 1 gained, 0 lost, of 4" in said["compare"]
    assert re.search(r"cross-validated error .* [\d.]+ m before, [\d.]+ m after", said["compare"])
    database = Database(database_url)
    stored = database.read_now(lambda c: list_radio_maps(c, site_id="hall", limit=9))
    database.close_now()
    by_version = {one.version: (one.name, one.fingerprints, one.active) for one in stored}
    assert by_version == {1: ("old", 8, True), 2: ("Spring", 8, False), 3: ("Spring", 8, False)}
    with zipfile.ZipFile(tmp_path / "hall-spring.zip") as archive:
        counts = np.load(io.BytesIO(archive.read("count.npy")), allow_pickle=False)
    assert set(counts.tolist()) == {5}
    # The notebook of docs/formats.md reads the same file.
    scope: dict[str, object] = {}
    (notebook,) = blocks("formats.md", "python")
    exec(notebook, scope)
    assert scope["loudest"] in KEYS
    assert json.dumps(scope["about"]["provenance"]["surveys"]) == '["points"]'


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("build", "--site", "none"), "there is no site 'none'"),
        (("build", "--site", "hall", "--survey", "gone"), "has no survey 'gone'"),
        (("activate", "gone"), "there is no radio map 'gone'"),
        (("rollback", "--site", "hall"), "had no radio map before the active one"),
        (("import", "missing.zip", "--site", "hall"), "missing.zip"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    pharos: Pharos, active: str, words: tuple[str, ...], message: str
) -> None:
    code, _, err = pharos("radio-map", *words)
    assert code == 1
    assert err.startswith("pharos: ")
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_the_active_map_is_not_deleted(pharos: Pharos, active: str) -> None:
    code, _, err = pharos("radio-map", "delete", active)
    assert (code, "is active" in err) == (1, True)


def test_the_list_shows_whole_ids_on_a_terminal_of_80_columns(
    pharos: Pharos, active: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert active in pharos("radio-map", "list", "--site", "hall")[1]
