import json
from pathlib import Path

import pytest
from typer.testing import CliRunner
from wifi_hall import levels_dbm

from app.cli.errors import CommandError
from app.cli.survey import surveying
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.survey import SurveyPoint
from app.services.errors import AppError
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.migrate import upgrade
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.surveys import (
    StoredSurvey,
    add_records,
    begin_survey,
    complete_survey,
    points_row,
)


@pytest.fixture
def stored(tmp_path: Path) -> tuple[str, str]:
    """Return a database with a radio map, and the map's id."""
    url = f"sqlite:///{tmp_path / 'pharos.db'}"
    upgrade(url)
    grid = (0.0, 5.0, 10.0)
    walked = [Fingerprint(0, x, y, levels_dbm(x, y), {}, f"row-{y}") for x in grid for y in grid]

    def fill(connection):
        insert_site(connection, StoredSite("hall", "Hall", 0.0))
        insert_floor(connection, StoredFloor("hall-F1", "hall", "F1", 0, 12.0, 12.0))
        radio_map = build_radio_map(("hall-F1",), walked)
        return save_radio_map(
            connection, "hall", radio_map, RadioMapOrigin("survey", 0.0), activate=True
        )

    database = Database(url)
    radio_map = database.write_now(fill)
    database.close_now()
    return url, radio_map.radio_map_id


def test_a_report_is_printed_and_written(stored: tuple[str, str], tmp_path: Path):
    url, radio_map_id = stored
    file, page = tmp_path / "report.json", tmp_path / "report.html"
    asked = ["report", radio_map_id, "--database", url, "--json", str(file), "--html", str(page)]
    result = CliRunner().invoke(surveying, asked, catch_exceptions=False)
    assert result.exit_code == 0
    assert "thin spots" in result.stdout
    assert json.loads(file.read_text())["floors"][0]["scans"] == 9
    assert "data:image/png" in page.read_text()


def test_ageing_without_traffic_finds_nothing(stored: tuple[str, str]):
    url, radio_map_id = stored
    result = CliRunner().invoke(
        surveying, ["ageing", radio_map_id, "--database", url], catch_exceptions=False
    )
    assert result.exit_code == 0
    assert "none" in result.stdout


def test_a_radio_map_that_is_not_there_is_said_so(stored: tuple[str, str]):
    url, _ = stored
    with pytest.raises(AppError, match="no radio map 'other'"):
        CliRunner().invoke(
            surveying, ["report", "other", "--database", url], catch_exceptions=False
        )


def test_the_report_of_a_survey_is_asked_for_by_its_id(stored: tuple[str, str], tmp_path: Path):
    url, radio_map_id = stored
    database = Database(url)
    point = [SurveyPoint(f"P{i}", "hall-F1", i, 5.0, levels_dbm(i, 5.0), {}) for i in (1.0, 6.0)]
    survey = StoredSurvey("spring", "hall", "Spring", "csv", 0.0)

    def fill(connection):
        begin_survey(connection, survey)
        add_records(connection, "spring", [points_row(point)])
        complete_survey(connection, survey)

    database.write_now(fill)
    database.close_now()
    file = tmp_path / "survey.json"
    asked = ["report", "--survey", "spring", "--database", url, "--json", str(file)]
    result = CliRunner().invoke(surveying, asked, catch_exceptions=False)
    assert result.exit_code == 0
    assert "floors" in result.stdout
    assert json.loads(file.read_text())["floors"][0]["scans"] == 2
    for both_or_none in ([], [radio_map_id, "--survey", "spring"]):
        with pytest.raises(CommandError, match="name a radio map, or a survey"):
            CliRunner().invoke(
                surveying, ["report", *both_or_none, "--database", url], catch_exceptions=False
            )
