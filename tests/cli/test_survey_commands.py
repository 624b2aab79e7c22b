"""``pharos survey list``, ``survey upload`` and ``jobs``: what an admin is told of surveys."""

import socket
from pathlib import Path

import pytest
from command_line import Pharos

from app.storage.database import Database
from app.storage.jobs import StoredJob, insert_job
from app.storage.sites import StoredSite, insert_site
from app.storage.surveys import Holding, StoredSurvey, begin_survey, complete_survey


@pytest.fixture(autouse=True)
def _eighty_columns(pharos: Pharos, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.fixture
def surveyed(database_url: str) -> None:
    """Store two surveys, and two jobs."""

    def fill(connection):
        insert_site(connection, StoredSite("hall", "Hall", 0.0))
        for name, created_s in (("old", 1.0), ("new", 2.0)):
            holdings = (Holding("hall-0", 3, 40, 0, 9),)
            survey = StoredSurvey(f"survey-{name}", "hall", name, "ms2020", created_s, holdings)
            begin_survey(connection, survey)
            complete_survey(connection, survey)
        job = StoredJob("a" * 32, "hall", "survey import", "receiving", 1.0)
        insert_job(connection, job.done({"survey_id": "survey-old"}, 2.0))
        job = StoredJob("b" * 32, "hall", "radio map build", "running", 3.0)
        insert_job(connection, job.failed("server_stopped", "the server was stopped", 4.0))

    database = Database(database_url)
    database.write_now(fill)
    database.close_now()


@pytest.mark.usefixtures("surveyed")
def test_surveys_are_listed_the_newest_first_with_whole_ids(pharos: Pharos) -> None:
    code, out, _ = pharos("survey", "list", "--site", "hall")
    assert code == 0
    assert 0 < out.index("survey-new") < out.index("survey-old")
    assert "survey-" not in pharos("survey", "list", "--site", "other")[1]


@pytest.mark.usefixtures("surveyed")
def test_jobs_tell_what_came_of_them(pharos: Pharos) -> None:
    code, out, _ = pharos("jobs")
    assert code == 0
    assert 0 < out.index("b" * 32) < out.index("a" * 32)
    _, done, _ = pharos("jobs", "--state", "done")
    assert "a" * 32 in done
    assert "b" * 32 not in done
    assert "b" * 32 not in pharos("jobs", "--kind", "survey import")[1]
    assert "a" * 32 not in pharos("jobs", "--limit", "1")[1]


def upload(pharos: Pharos, file: Path, server: str) -> tuple[int, str, str]:
    asked = ("survey", "upload", str(file), "--site", "hall", "--token", "t")
    return pharos(*asked, "--server", server)


@pytest.fixture
def walk_file(tmp_path: Path) -> Path:
    file = tmp_path / "walk.txt"
    file.write_text("x")
    return file


def test_an_upload_to_a_port_where_nobody_listens_says_so(pharos: Pharos, walk_file: Path) -> None:
    with socket.socket() as bound:
        # Bound and not listening: nobody else gets the port, and connections are refused.
        bound.bind(("127.0.0.1", 0))
        server = f"http://127.0.0.1:{bound.getsockname()[1]}"
        code, _, err = upload(pharos, walk_file, server)
    assert code == 1
    assert f"pharos: nobody answers at {server}" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("server", ["localhost:8000", "nonsense"])
def test_an_address_that_is_none_is_refused(pharos: Pharos, walk_file: Path, server: str) -> None:
    code, _, err = upload(pharos, walk_file, server)
    assert code == 2
    assert f"pharos: --server '{server}' cannot be used" in err


def test_a_folder_is_not_uploaded(pharos: Pharos, tmp_path: Path) -> None:
    code, _, err = upload(pharos, tmp_path, "http://127.0.0.1:1")
    assert code == 2
    assert "is a folder: put its files into one zip" in err
