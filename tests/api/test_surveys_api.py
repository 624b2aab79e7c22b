import asyncio
import gzip
import json
import tracemalloc
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import httpx
import pytest
from api_server import ApiServer, batch, ble_record, on_both_databases
from live_server import LiveServer, listening
from survey_files import ms2020_trace

from app.api.multipart import file_part
from app.core.site import Floor
from app.core.survey import SurveyWalk
from app.formats.survey_places import SurveyFrame
from app.services.errors import AppError
from app.services.survey_parsing import Parsed, ParseTask, Refused, Rows, parse_upload
from app.storage.surveys import records_of_survey

pytestmark = pytest.mark.anyio

HEADER = "point,floor_id,x,y,kind,key,rssi_dbm\n"
CSV = HEADER + "".join(
    f"P{i},lab-0,{i},5,wifi,mac:aabbccddee{j:02x},-{50 + j}\n" for i in range(10) for j in range(3)
)
LAB = SurveyFrame((Floor("lab-0", "Ground", "", 0, 0.0, 0.0, 20.0, 10.0),))


async def ended(server: ApiServer, job_id: str) -> dict:
    """Return a job once it has ended."""
    async with server.client("viewer") as client:
        while True:
            job = (await client.get(f"/v1/jobs/{job_id}")).json()
            if job["state"] in {"done", "failed"}:
                return job
            await asyncio.sleep(0.02)


async def upload(server: ApiServer, body: bytes, **options: object) -> dict:
    """Upload a survey of the lab and return its job when it has ended."""
    async with server.client("surveyor") as client:
        reply = await client.post("/v1/surveys?site_id=lab&name=s", content=body, **options)
        assert reply.status_code == 202, reply.text
        assert reply.headers["location"] == f"/v1/jobs/{reply.json()['job_id']}"
        return await ended(server, reply.json()["job_id"])


async def listed(server: ApiServer) -> list[dict]:
    async with server.client("viewer") as client:
        return (await client.get("/v1/surveys?site_id=lab")).json()["items"]


@on_both_databases
async def test_an_upload_becomes_a_survey_that_is_listed_and_deleted(server: ApiServer):
    body = gzip.compress((CSV + "P9,lab-0,9,5,wifi,mac:aabbccddee01,9\n").encode())
    job = await upload(server, body)
    assert job["state"] == "done", job
    assert job["progress"] == {
        "total_bytes": len(body),
        "received_bytes": len(body),
        "read_bytes": len(body),
        "traces": 0,
        "fingerprints": 10,
        "unusable": 1,
    }
    unusable = {
        "counts": {"the level is not in -127..-1 dBm": 1},
        "first": [
            {"place": "s:line 32", "reason": "the level is not in -127..-1 dBm", "detail": "'9'"}
        ],
    }
    assert job["result"]["format"] == "csv"
    assert job["result"]["unusable"] == unusable
    (survey,) = await listed(server)
    assert survey["survey_id"] == job["result"]["survey_id"]
    assert survey["unusable"] == unusable
    assert survey["floors"] == [
        {
            "floor_id": "lab-0",
            "walks": 0,
            "scans": 0,
            "fingerprints": 10,
            "transmitters": 3,
            "first": None,
            "last": None,
        }
    ]
    async with server.client("annex-surveyor") as client:
        url = f"/v1/surveys/{survey['survey_id']}"
        assert (await client.get(url)).status_code == 403
        assert (await client.delete(url)).status_code == 403
        assert (await client.get(f"/v1/jobs/{job['job_id']}")).status_code == 403
        assert (await client.post("/v1/surveys?site_id=lab", content=b"x")).status_code == 403
    async with server.client("surveyor") as client:
        assert (await client.get(url)).json() == survey
        assert (await client.delete(url)).status_code == 204
        assert (await client.delete(url)).status_code == 404
    assert await listed(server) == []


async def test_a_form_with_a_file_and_a_floor_of_all_of_it(server: ApiServer):
    async with server.client("surveyor") as client:
        reply = await client.post(
            "/v1/surveys?site_id=lab&floor_id=lab-0",
            files={"file": ("walk.txt", ms2020_trace("F9").encode())},
        )
    job = await ended(server, reply.json()["job_id"])
    assert job["result"]["format"] == "ms2020"
    (survey,) = await listed(server)
    assert survey["device_model"] == "OPPO PBCM10"
    assert survey["floors"][0] | {"walks": 1, "scans": 11} == survey["floors"][0]
    assert survey["floors"][0]["first"] == "2023-11-14T22:13:20.000Z"
    database = server.app.state.context.database
    (walk,) = await database.read(lambda c: list(records_of_survey(c, survey["survey_id"])))
    assert isinstance(walk, SurveyWalk)
    assert len(walk.waypoints) == 3
    assert len(walk.strides) >= 30


@pytest.mark.parametrize(
    ("body", "detail"),
    [
        (b"", "the upload is empty"),
        (b"Dear sir", "nothing in it can be used"),
        (CSV.replace("lab-0", "attic").encode(), "nothing in it can be used"),
        (gzip.compress(CSV.encode())[:-9], "it is cut off: the compressed file has no end"),
    ],
)
def test_a_file_with_nothing_usable_is_refused_clearly(tmp_path: Path, body: bytes, detail: str):
    path = tmp_path / "upload"
    path.write_bytes(body)
    *_, last = parse_upload(ParseTask(path, "s", LAB))
    assert isinstance(last, Refused)
    assert last.detail == detail


async def test_a_refused_upload_stores_nothing_although_its_beginning_was_good(server: ApiServer):
    rows = "".join(f"P{i},lab-0,1,5,wifi,mac:aabbccddee01,-50\n" for i in range(12_000))
    job = await upload(server, gzip.compress((HEADER + rows).encode())[:-9])
    assert job["state"] == "failed"
    assert job["problem"]["code"] == "nothing_usable"
    assert "cut off" in job["problem"]["detail"]
    assert await listed(server) == []
    database = server.app.state.context.database
    await server.app.state.context.uploads.settle()
    await database.flush()
    for table in ("surveys", "survey_records"):
        query = f"SELECT count(*) FROM {table}"
        assert await database.read(lambda c, q=query: c.exec_driver_sql(q).scalar()) == 0
    assert list(server.app.state.context.uploads.spool.folder.iterdir()) == []


async def test_an_upload_is_continued_where_the_connection_broke(database_url: str):
    body = CSV.encode()
    async with listening(database_url) as live, live.api.client("surveyor") as client:
        wish = {"site_id": "lab", "total_bytes": len(body)}
        begun = await client.post("/v1/surveys/uploads", json=wish)
        assert begun.status_code == 201
        url, job_id = begun.headers["location"], begun.json()["job_id"]
        writer = await _begun(live, f"{url}?offset=0", body[:300], len(body))
        assert await _received(client, job_id) == 300
        writer.close()
        await writer.wait_closed()
        wrong = await _answered_when_free(client, f"{url}?offset=301", body[301:])
        assert wrong.status_code == 409
        assert wrong.headers["upload-offset"] == "300"
        assert (await client.patch(f"{url}?offset=300", content=body)).status_code == 413
        received = await _received(client, job_id)
        last = await client.patch(f"{url}?offset={received}", content=body[received:])
        assert last.status_code == 202
        assert last.json()["state"] == "waiting"
        assert (await ended(live.api, job_id))["progress"]["fingerprints"] == 10
        assert (await client.patch(f"{url}?offset=0", content=b"x")).status_code == 404


async def _begun(
    live: LiveServer, target: str, sent: bytes, announced: int
) -> asyncio.StreamWriter:
    _, writer = await asyncio.open_connection("127.0.0.1", live.port)
    head = f"PATCH {target} HTTP/1.1\r\nHost: x\r\nContent-Length: {announced}\r\n"
    head += f"Authorization: Bearer {live.api.secrets['surveyor']}\r\n\r\n"
    writer.write(head.encode() + sent)
    await writer.drain()
    return writer


async def _received(client: httpx.AsyncClient, job_id: str) -> int:
    """Return how much of an upload has arrived, once something has."""
    while True:
        job = (await client.get(f"/v1/jobs/{job_id}")).json()
        if received := int(job["progress"]["received_bytes"]):
            return received
        await asyncio.sleep(0.02)


async def _answered_when_free(client: httpx.AsyncClient, url: str, body: bytes) -> httpx.Response:
    """Send until the server has noticed that the connection broke, as a phone would."""
    while True:
        reply = await client.patch(url, content=body)
        if "another request" not in reply.text:
            return reply
        await asyncio.sleep(0.02)


async def test_uploads_of_no_site_floor_or_size_are_refused(server: ApiServer):
    async with server.client("admin") as client:
        for query, status in (
            ("site_id=nowhere", 404),
            ("site_id=annex", 422),
            ("site_id=lab&floor_id=attic", 422),
            ("name=x", 422),
        ):
            assert (await client.post(f"/v1/surveys?{query}", content=b"x")).status_code == status
        huge = {"site_id": "lab", "total_bytes": 1 << 40}
        assert (await client.post("/v1/surveys/uploads", json=huge)).status_code == 413
    async with server.client("viewer") as client:
        assert (await client.post("/v1/surveys?site_id=lab", content=b"x")).status_code == 403


async def test_a_job_is_watched_over_the_stream(database_url: str):
    async with listening(database_url) as live:
        async with live.socket("/v1/stream", "phone-7") as phone:
            await phone.send('{"op": "subscribe", "id": "j", "topic": "jobs"}')
            assert json.loads(await phone.recv())["code"] == "role_forbidden"
        async with live.socket("/v1/stream", "annex-viewer") as other:
            await other.send('{"op": "subscribe", "id": "j", "topic": "jobs"}')
            assert json.loads(await other.recv())["op"] == "subscribed"
            async with live.socket("/v1/stream", "viewer") as socket:
                await socket.send('{"op": "subscribe", "id": "j", "topic": "jobs"}')
                assert json.loads(await socket.recv())["snapshot"] == []
                told = asyncio.create_task(_told(socket))
                job = await upload(live.api, CSV.encode())
                jobs = await told
            await other.send('{"op": "ping"}')
            assert json.loads(await other.recv())["op"] == "pong"
    assert jobs[-1] == job
    states = [told["state"] for told in jobs]
    assert states == sorted(states, key=["receiving", "waiting", "running", "done"].index)
    read_bytes = [told["progress"].get("read_bytes", 0) for told in jobs]
    assert read_bytes == sorted(read_bytes)


async def _told(socket) -> list[dict]:
    jobs: list[dict] = []
    while not jobs or jobs[-1]["state"] != "done":
        frame = json.loads(await socket.recv())
        jobs += frame["data"]
    return jobs


def _session_records() -> Iterator[dict[str, object]]:
    start_ms = 1_795_314_000_000
    for i in range(5):
        yield ble_record(2.0 + i, 5.0, start_ms + 200.0 * i)
        yield {"k": "step", "t_ms": start_ms + 200.0 * i, "heading_deg": 90.0}
    for i, x in ((0, 2.0), (4, 6.0)):
        truth = {"k": "truth", "t_ms": start_ms + 200.0 * i, "floor_id": "lab-0", "x": x, "y": 5.0}
        yield truth


@on_both_databases
async def test_a_session_with_truths_becomes_a_walk(server: ApiServer):
    async with server.client("surveyor") as client:
        reply = await client.post("/v1/ingest", json=batch(*_session_records(), site="lab"))
        assert reply.status_code == 200, reply.text
        wish = {"device_id": "phone-7", "session": "walk-1"}
        taken = await client.post("/v1/surveys/from-session", json=wish)
        assert taken.status_code == 201, taken.text
        survey = taken.json()
        assert survey["format"] == "session"
        assert survey["floors"][0] | {"walks": 1, "scans": 5} == survey["floors"][0]
        assert (await client.get(taken.headers["location"])).json() == survey
        missing = {**wish, "session": "walk-2"}
        assert (await client.post("/v1/surveys/from-session", json=missing)).status_code == 404
        await client.post(
            "/v1/ingest",
            json=batch(*list(_session_records())[:10], session="untold", site="lab"),
        )
        nothing = await client.post("/v1/surveys/from-session", json={**wish, "session": "untold"})
        assert nothing.status_code == 422
        assert "no truth records" in nothing.json()["detail"]
    database = server.app.state.context.database
    (walk,) = await database.read(lambda c: list(records_of_survey(c, survey["survey_id"])))
    assert walk.waypoints[:, 1].tolist() == [2.0, 6.0]
    assert walk.strides[:, 2].tolist() == [0.0] * 5


@pytest.mark.parametrize("size", [1, 7, 4096])
async def test_the_file_of_a_form_is_cut_out_whatever_pieces_it_comes_in(size: int):
    content = b"a\r\n--b\r\n\r\n--bounda" * 50
    body = (
        b'--boundary\r\nContent-Disposition: form-data; name="f"; filename="x"\r\n\r\n'
        + content
        + b"\r\n--boundary--\r\n"
    )

    async def pieces(whole: bytes) -> AsyncIterator[bytes]:
        for i in range(0, len(whole), size):
            yield whole[i : i + size]

    assert b"".join([p async for p in file_part(pieces(body), b"boundary")]) == content
    with pytest.raises(AppError):
        _ = [p async for p in file_part(pieces(body[:-30]), b"boundary")]


def _wide(rows: int) -> bytes:
    header = ",".join([f"WAP{i:03}" for i in range(200)] + ["X", "Y", "FLOOR"])
    row = ",".join(["-60"] * 20 + ["100"] * 180 + ["5", "5", "Ground"])
    return "\n".join([header, *[row] * rows]).encode()


def test_memory_does_not_grow_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("app.services.survey_parsing.ROWS_BYTES", 1 << 14)
    peaks = []
    for rows in (400, 1600):
        path = tmp_path / f"{rows}.csv"
        path.write_bytes(_wide(rows))
        tracemalloc.start()
        found = 0
        for message in parse_upload(ParseTask(path, "wide", LAB)):
            found += len(message.rows) if isinstance(message, Rows) else 0
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert isinstance(message, Parsed)
        assert message.holdings[0].fingerprints == rows
        assert found == -(-rows // 200)
    assert peaks[1] < peaks[0] + 200_000


def test_a_survey_of_endless_transmitters_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("app.services.survey_parsing.MAX_TRANSMITTERS", 100)
    path = tmp_path / "endless.csv"
    rows = (f"P{i},lab-0,1,1,wifi,mac:{i:012x},-50\n" for i in range(200))
    path.write_text(HEADER + "".join(rows))
    *_, last = parse_upload(ParseTask(path, "endless", LAB))
    assert last == Refused("it names more than 100 transmitters", {"counts": {}, "first": []})


async def test_a_survey_is_renamed_if_nobody_was_faster(server: ApiServer):
    survey_id = (await upload(server, CSV.encode()))["result"]["survey_id"]
    url = f"/v1/surveys/{survey_id}"
    async with server.client("surveyor") as client:
        seen = (await client.get(url)).headers["etag"]
        renamed = await client.patch(url, json={"name": "Spring"}, headers={"If-Match": seen})
        assert (renamed.status_code, renamed.json()["name"]) == (200, "Spring")
        assert renamed.headers["etag"] != seen
        late = await client.patch(url, json={"name": "Autumn"}, headers={"If-Match": seen})
        assert (late.status_code, late.json()["code"]) == (412, "etag_mismatch")
        held = await client.get(url, headers={"If-None-Match": renamed.headers["etag"]})
        assert held.status_code == 304
        wrong = await client.patch(url, json={"name": "x", "site_id": "annex"})
        assert wrong.json()["errors"][0]["pointer"] == "#/site_id"
        assert (await client.get(url)).json() == renamed.json()
    async with server.client("viewer") as client:
        assert (await client.patch(url, json={"name": "x"})).status_code == 403
    async with server.client("annex-surveyor") as client:
        assert (await client.patch(url, json={"name": "x"})).status_code == 403


@on_both_databases
async def test_surveys_are_listed_the_newest_first_page_by_page(server: ApiServer):
    made = []
    for _ in range(3):
        server.clock.time_s += 1.0
        made.append((await upload(server, CSV.encode()))["result"]["survey_id"])
    async with server.client("viewer") as client:
        first = (await client.get("/v1/surveys?limit=2")).json()
        rest = (await client.get(f"/v1/surveys?limit=2&cursor={first['next_cursor']}")).json()
    pages = [[one["survey_id"] for one in page["items"]] for page in (first, rest)]
    assert pages == [[made[2], made[1]], [made[0]]]
    assert rest["next_cursor"] is None


async def test_a_parameter_of_the_query_is_named_as_one(server: ApiServer):
    begun = {"site_id": "lab", "floor_id": "attic", "total_bytes": 9}
    async with server.client("surveyor") as client:
        in_query = await client.post("/v1/surveys?site_id=lab&floor_id=attic", content=b"x")
        in_body = await client.post("/v1/surveys/uploads", json=begun)
    assert (in_query.status_code, in_body.status_code) == (422, 422)
    assert in_query.json()["errors"][0]["pointer"] == "query:floor_id"
    assert in_body.json()["errors"][0]["pointer"] == "#/floor_id"
