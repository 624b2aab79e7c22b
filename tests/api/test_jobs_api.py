import asyncio
import os
import resource
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from api_server import NOW_S, ApiServer, MovableClock, fill
from server_process import PATIENCE

from app.config import Settings
from app.main import create_app
from app.services.survey_spool import Spool
from app.services.survey_uploads import IDLE_S, MAX_INTERRUPTIONS, MAX_OPEN, ORPHAN_S
from app.storage.database import Database
from app.storage.jobs import StoredJob, insert_job
from app.storage.survey_uploads import StoredUpload, list_uploads, put_upload

pytestmark = pytest.mark.anyio

SMALL = 2 << 20
"""Bytes; the database has less."""
CSV = b"point,floor_id,x,y,kind,key,rssi_dbm\nP1,lab-0,1,5,wifi,mac:aabbccddee01,-50\n"


def job(number: int, **fields: object) -> StoredJob:
    values: dict[str, object] = {"site_id": "lab", "kind": "survey import", "state": "done"}
    values |= {"created_s": NOW_S + number // 2, **fields}
    return StoredJob(job_id=f"{number:032x}", **values)  # type: ignore[arg-type]


async def add(server: ApiServer, *jobs: StoredJob) -> None:
    database = server.app.state.context.database
    for one in jobs:
        await database.write(lambda c, one=one: insert_job(c, one))


async def ids(client, query: str) -> list[int]:
    listed = (await client.get(f"/v1/jobs?{query}")).raise_for_status().json()
    return [int(one["job_id"], 16) for one in listed["items"]]


@asynccontextmanager
async def restarted(
    database_url: str, *jobs: StoredJob, uploads: tuple[StoredUpload, ...] = ()
) -> AsyncIterator[ApiServer]:
    """Serve a database in which a server that is no more has left jobs and uploads."""
    secrets = fill(database_url)

    def leave(connection) -> None:
        for one in jobs:
            insert_job(connection, one)
        for upload in uploads:
            put_upload(connection, upload)

    database = Database(database_url)
    database.write_now(leave)
    database.close_now()
    clock = MovableClock()
    app = create_app(Settings(database_url=database_url, migrate=False, **PATIENCE), clock)
    async with app.router.lifespan_context(app):
        yield ApiServer(app, clock, secrets)


async def test_jobs_are_listed_newest_first_in_pages(server: ApiServer):
    await add(server, *(job(i) for i in range(5)))
    async with server.client("viewer") as client:
        found, query = [], "limit=2"
        while True:
            page = (await client.get(f"/v1/jobs?{query}")).raise_for_status().json()
            found += [int(one["job_id"], 16) for one in page["items"]]
            if page["next_cursor"] is None:
                break
            query = f"limit=2&cursor={page['next_cursor']}"
        assert found == [4, 3, 2, 1, 0]
        single = (await client.get(f"/v1/jobs/{4:032x}")).json()
        assert (await client.get("/v1/jobs?limit=1")).json()["items"] == [single]
        wrong = await client.get("/v1/jobs?cursor=Zm9v")
        assert (wrong.status_code, wrong.json()["code"]) == (400, "invalid_cursor")


async def test_jobs_are_chosen_by_site_kind_and_state(server: ApiServer):
    failed = job(3, state="failed", problem={"code": "x", "detail": "y"})
    await add(server, job(1), job(2, kind="radio map build"), failed, job(4, site_id="annex"))
    async with server.client("viewer") as client:
        assert await ids(client, "site_id=lab") == [3, 2, 1]
        assert await ids(client, "kind=radio%20map%20build") == [2]
        assert await ids(client, "site_id=lab&kind=survey%20import&state=failed") == [3]
        assert (await client.get("/v1/jobs?state=lost")).status_code == 422
    async with server.client("annex-viewer") as client:
        assert await ids(client, "") == [4]
        assert (await client.get("/v1/jobs?site_id=lab")).status_code == 403
    async with server.client("phone-7") as client:
        assert (await client.get("/v1/jobs")).status_code == 403


async def test_a_job_that_was_running_when_the_server_died_is_failed_with_the_reason(
    database_url: str,
):
    cut_off = job(1, kind="radio map build", state="running", progress={"surveys": 1})
    async with restarted(database_url, cut_off) as server, server.client("viewer") as client:
        (told,) = (await client.get("/v1/jobs?state=failed")).json()["items"]
        assert told["job_id"] == cut_off.job_id
        assert told["problem"]["code"] == "server_stopped"
        assert "nothing was changed" in told["problem"]["detail"]
        assert told["ended"] is not None
        assert (await client.get("/v1/jobs?state=running")).json()["items"] == []


def left(number: int, **fields: object) -> StoredUpload:
    values: dict[str, object] = {"name": "spring", "floor_id": None, "total_bytes": len(CSV)}
    values |= {"touched_s": NOW_S, **fields}
    return StoredUpload(job_id=f"{number:032x}", **values)  # type: ignore[arg-type]


def spool_of(database_url: str) -> Spool:
    spool = Spool(Path(database_url.removeprefix("sqlite:///")).with_name("pharos-uploads"))
    spool.folder.mkdir()
    return spool


@pytest.mark.parametrize(
    ("state", "upload", "kept", "reason"),
    [
        ("receiving", left(1, total_bytes=None), CSV[:30], "in one go"),
        ("receiving", left(1), None, "is gone"),
        ("receiving", left(1), CSV[:10], "is gone"),
        ("running", left(1, interruptions=MAX_INTERRUPTIONS - 1), CSV, "stopped 3 times"),
        ("waiting", left(1, floor_id="attic"), CSV, "no floor 'attic'"),
    ],
)
async def test_an_upload_that_cannot_go_on_says_why_and_is_forgotten(
    database_url: str, state: str, upload: StoredUpload, kept: bytes | None, reason: str
):
    spool = spool_of(database_url)
    if kept is not None:
        spool.path(upload.job_id).write_bytes(kept)
    received = {"received_bytes": len(CSV) if state != "receiving" else 30}
    begun = job(1, state=state, progress=received)
    async with restarted(database_url, begun, uploads=(upload,)) as server:
        async with server.client("surveyor") as client:
            told = (await client.get(f"/v1/jobs/{begun.job_id}")).json()
            assert (told["state"], told["problem"]["code"]) == ("failed", "server_stopped")
            assert reason in told["problem"]["detail"]
            gone = await client.patch(f"/v1/surveys/uploads/{begun.job_id}?offset=30", content=b"x")
            assert gone.status_code == 404
        database = server.app.state.context.database
        await database.flush()
        assert await database.read(list_uploads) == []
    assert list(spool.folder.iterdir()) == []


async def test_an_upload_whose_job_has_ended_is_forgotten_and_the_job_stays(database_url: str):
    spool = spool_of(database_url)
    done = job(1, result={"survey_id": "spring"}, ended_s=NOW_S)
    spool.path(done.job_id).write_bytes(CSV)
    async with restarted(database_url, done, uploads=(left(1),)) as server:
        async with server.client("viewer") as client:
            told = (await client.get(f"/v1/jobs/{done.job_id}")).json()
        assert (told["state"], told["result"]) == ("done", {"survey_id": "spring"})
        database = server.app.state.context.database
        await database.flush()
        assert await database.read(list_uploads) == []
    assert list(spool.folder.iterdir()) == []


async def test_bytes_that_nobody_was_told_of_are_sent_again(database_url: str):
    spool = spool_of(database_url)
    begun = job(1, state="receiving", progress={"received_bytes": 30})
    # A power cut may leave anything behind what was made to last.
    spool.path(begun.job_id).write_bytes(CSV[:30] + bytes(12))
    async with (
        restarted(database_url, begun, uploads=(left(1),)) as server,
        server.client("surveyor") as client,
    ):
        url = f"/v1/surveys/uploads/{begun.job_id}"
        rest = await client.patch(f"{url}?offset=30", content=CSV[30:])
        assert rest.status_code == 202, rest.text
        while True:
            told = (await client.get(f"/v1/jobs/{begun.job_id}")).json()
            if told["ended"] is not None:
                break
            await asyncio.sleep(0.02)
    assert told["progress"]["fingerprints"] == 1


async def test_an_upload_is_given_up_or_forgotten_after_a_day(server: ApiServer):
    uploads = server.app.state.context.uploads
    wish = {"site_id": "lab", "total_bytes": 100}
    async with server.client("surveyor") as client, server.client("annex-surveyor") as stranger:
        begun = [await client.post("/v1/surveys/uploads", json=wish) for _ in range(2)]
        urls = [reply.headers["location"] for reply in begun]
        assert (await stranger.delete(urls[0])).status_code == 403
        assert (await client.delete(urls[0])).status_code == 204
        assert (await client.delete(urls[0])).status_code == 404
        server.clock.time_s += IDLE_S - 1.0
        await uploads.sweep()
        assert (await client.get(f"/v1/jobs/{begun[1].json()['job_id']}")).json()["ended"] is None
        server.clock.time_s += 2.0
        await uploads.sweep()
        told = [(await client.get(f"/v1/jobs/{r.json()['job_id']}")).json() for r in begun]
    assert [t["problem"]["code"] for t in told] == ["upload_abandoned"] * 2
    assert list(uploads.spool.folder.iterdir()) == []


async def test_an_upload_ends_with_its_site(server: ApiServer):
    uploads = server.app.state.context.uploads
    floor = {"floor_id": "barn-0", "site_id": "barn", "name": "Ground", "ordinal": 0}
    async with server.client("admin") as client:
        await client.post("/v1/sites", json={"site_id": "barn", "name": "Barn"})
        await client.post("/v1/floors", json={**floor, "width": 20, "height": 10})
        wish = {"site_id": "barn", "total_bytes": 100}
        url = (await client.post("/v1/surveys/uploads", json=wish)).headers["location"]
        for place in ("/v1/floors/barn-0", "/v1/sites/barn"):
            gone = await client.delete(place, headers={"If-Match": "*"})
            assert gone.status_code == 204
        sent = await client.patch(f"{url}?offset=0", content=b"x")
        assert (sent.status_code, sent.json()["code"]) == (404, "not_found")
        assert (await client.get(f"/v1/jobs/{url.rpartition('/')[2]}")).status_code == 404
    assert list(uploads.spool.folder.iterdir()) == []


async def test_no_more_uploads_are_open_than_may_be_however_they_are_asked_for(server: ApiServer):
    wish = {"site_id": "lab", "total_bytes": 100}
    async with server.client("surveyor") as client:
        asked = (client.post("/v1/surveys/uploads", json=wish) for _ in range(MAX_OPEN + 4))
        replies = await asyncio.gather(*asked)
    assert sorted(reply.status_code for reply in replies) == [201] * MAX_OPEN + [429] * 4


@pytest.fixture
def small_files() -> Iterator[int]:
    """Let no file of this process grow beyond some bytes, as on a full disk; return how many."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL, limits[1]))
    yield SMALL
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


async def test_a_file_that_the_disk_has_no_room_for_takes_no_place_among_uploads(
    server: ApiServer, small_files: int
):
    async with server.client("surveyor") as client:
        for _ in range(MAX_OPEN + 1):
            sent = await client.post("/v1/surveys?site_id=lab", content=b"x" * (small_files + 1))
            assert sent.status_code == 500
        jobs = (await client.get("/v1/jobs?state=failed")).json()["items"]
    assert {job["problem"]["code"] for job in jobs} == {"upload_abandoned"}
    assert list(server.app.state.context.uploads.spool.folder.iterdir()) == []


async def test_files_of_no_upload_are_removed_once_they_are_old(server: ApiServer):
    uploads = server.app.state.context.uploads
    async with server.client("surveyor") as client:
        wish = {"site_id": "lab", "total_bytes": 100}
        mine = (await client.post("/v1/surveys/uploads", json=wish)).json()["job_id"]
    server.clock.time_s += ORPHAN_S / 4
    old_s = server.clock.time_s - ORPHAN_S - 1.0
    folder = uploads.spool.folder
    for name, time_s in (("a" * 32, old_s), ("b" * 32, old_s + 2.0), ("notes.txt", old_s)):
        (folder / name).touch()
        os.utime(folder / name, (time_s, time_s))
    os.utime(folder / mine, (old_s, old_s))
    await uploads.sweep()
    assert {path.name for path in folder.iterdir()} == {"b" * 32, "notes.txt", mine}
