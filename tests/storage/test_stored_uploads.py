from collections.abc import Iterator
from dataclasses import replace

import pytest

from app.storage.database import Database
from app.storage.jobs import JobsAsked, StoredJob, fail_unended, get_job, insert_job, list_jobs
from app.storage.sites import StoredSite, delete_site, insert_site
from app.storage.survey_uploads import StoredUpload, delete_upload, list_uploads, put_upload

UPLOAD = StoredUpload("b", "spring", None, 1 << 40, 5.0)


@pytest.fixture
def database(storage_url: str) -> Iterator[Database]:
    """Return a database with a site and four jobs, two of them made at one moment."""
    opened = Database(storage_url)

    def fill(connection) -> None:
        insert_site(connection, StoredSite("lab", "Lab", 0.0))
        for job_id, created_s in (("a", 1.1), ("b", 2.2), ("c", 2.2), ("d", 3.3)):
            job = StoredJob(job_id, "lab", "survey import", "running", created_s)
            insert_job(connection, job)

    opened.write_now(fill)
    yield opened
    opened.close_now()


def test_jobs_of_one_moment_are_neither_lost_nor_told_twice_between_pages(database: Database):
    told, after = [], None
    while True:
        page = database.read_now(
            lambda c, after=after: list_jobs(c, JobsAsked("lab"), after=after, limit=1)
        )
        told.append(page[0].job_id)
        if len(page) == 1:
            break
        after = page[0].created_s, page[0].job_id
    assert told == ["d", "c", "b", "a"]


def test_only_jobs_that_nobody_goes_on_with_are_failed(database: Database):
    problem = {"code": "server_stopped", "detail": "x"}
    assert database.write_now(lambda c: fail_unended(c, problem, 9.0, but=["b"])) == 3
    assert database.write_now(lambda c: fail_unended(c, problem, 9.0)) == 1
    ended = database.read_now(lambda c: get_job(c, "a"))
    assert ended is not None
    assert (ended.state, ended.problem, ended.ended_s) == ("failed", problem, 9.0)


def test_an_upload_is_kept_as_it_stands_until_it_is_forgotten_or_its_site_is_gone(
    database: Database,
):
    for upload in (UPLOAD, replace(UPLOAD, interruptions=1), replace(UPLOAD, job_id="a")):
        database.write_now(lambda c, upload=upload: put_upload(c, upload))
    kept = {job.job_id: upload for job, upload in database.read_now(list_uploads)}
    assert kept == {
        "a": replace(UPLOAD, job_id="a"),
        "b": replace(UPLOAD, interruptions=1),
    }
    database.write_now(lambda c: delete_upload(c, "a"))
    assert [job.job_id for job, _ in database.read_now(list_uploads)] == ["b"]
    database.write_now(lambda c: delete_site(c, "lab"))
    assert database.read_now(list_uploads) == []
