"""An upload goes on where it was after the server was killed, and changes nothing before."""

import socket
import time
from typing import Any

import httpx
import pytest
from server_process import ServerProcess

HEADER = "point,floor_id,x,y,kind,key,rssi_dbm\n"
LIMIT_S = 100.0


def table(points: int) -> bytes:
    """Return a survey of some points with three access points each."""
    rows = (
        f"P{i},hall-0,{i % 20},5,wifi,mac:02005e00530{j},-{50 + j}\n"
        for i in range(points)
        for j in range(3)
    )
    return (HEADER + "".join(rows)).encode()


@pytest.fixture
def hall(live_server: ServerProcess) -> ServerProcess:
    """Return a server with a hall and an active radio map."""
    with live_server.client() as client:
        site = {"site_id": "hall", "name": "Hall"}
        client.post("/v1/sites", json=site).raise_for_status()
        floor = {"floor_id": "hall-0", "site_id": "hall", "name": "Ground", "ordinal": 0}
        client.post("/v1/floors", json={**floor, "width": 20, "height": 10}).raise_for_status()
        first = client.post("/v1/surveys?site_id=hall", content=table(10)).raise_for_status()
        assert ended(client, first.json()["job_id"])["state"] == "done"
        build = client.post("/v1/radio-maps", json={"site_id": "hall"}).raise_for_status()
        built = ended(client, build.json()["job_id"])["result"]["radio_map_id"]
        client.post(f"/v1/radio-maps/{built}/activate").raise_for_status()
    return live_server


def until(client: httpx.Client, job_id: str, *states: str, received: int = 0) -> dict[str, Any]:
    """Return a job once it is in one of the states and has received so much."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        job: dict[str, Any] = client.get(f"/v1/jobs/{job_id}").raise_for_status().json()
        if job["state"] in states and job["progress"].get("received_bytes", 0) >= received:
            return job
        assert time.monotonic() < deadline_s, job
        time.sleep(0.01)


def ended(client: httpx.Client, job_id: str) -> dict[str, Any]:
    return until(client, job_id, "done", "failed")


def stored(client: httpx.Client) -> tuple[list[str], list[str]]:
    """Return the ids of the surveys, and of the active radio map."""
    surveys = client.get("/v1/surveys?site_id=hall").json()["items"]
    active = client.get("/v1/radio-maps?site_id=hall&active=true").json()["items"]
    return [s["survey_id"] for s in surveys], [m["radio_map_id"] for m in active]


def begun(client: httpx.Client, body: bytes) -> str:
    wish = {"site_id": "hall", "name": "spring", "total_bytes": len(body)}
    job_id: str = client.post("/v1/surveys/uploads", json=wish).raise_for_status().json()["job_id"]
    return job_id


def send_some(server: ServerProcess, job_id: str, body: bytes, size: int) -> socket.socket:
    """Send the first bytes of an upload, and leave the request open."""
    head = (
        f"PATCH /v1/surveys/uploads/{job_id}?offset=0 HTTP/1.1\r\nHost: x\r\n"
        f"Content-Length: {len(body)}\r\nAuthorization: Bearer {server.token}\r\n\r\n"
    )
    connection = socket.create_connection(("127.0.0.1", server.port))
    connection.sendall(head.encode() + body[:size])
    return connection


@pytest.mark.timeout(240)
def test_an_upload_goes_on_by_its_offset_after_the_server_was_killed(hall: ServerProcess) -> None:
    body = table(2_000)
    half = len(body) // 2
    with hall.client() as client:
        before = stored(client)
        job_id = begun(client, body)
        with send_some(hall, job_id, body, half):
            # The job tells of every hundredth part.
            until(client, job_id, "receiving", received=half - len(body) // 50)
            hall.kill()
    hall.start()
    with hall.client() as client:
        job = client.get(f"/v1/jobs/{job_id}").json()
        received = job["progress"]["received_bytes"]
        assert job["state"] == "receiving"
        assert half - len(body) // 50 <= received <= half
        assert stored(client) == before
        url = f"/v1/surveys/uploads/{job_id}"
        wrong = client.patch(f"{url}?offset={received + 1}", content=b"x")
        assert (wrong.status_code, wrong.headers["upload-offset"]) == (409, str(received))
        rest = client.patch(f"{url}?offset={received}", content=body[received:])
        assert rest.status_code == 202
        done = until(client, job_id, "done", "failed")
        assert done["progress"]["fingerprints"] == 2_000
        surveys, active = stored(client)
        assert set(surveys) == {*before[0], done["result"]["survey_id"]}
        assert active == before[1]


@pytest.mark.timeout(240)
def test_a_file_whose_reading_was_cut_off_is_read_again(hall: ServerProcess) -> None:
    with hall.client() as client:
        before = stored(client)
        sent = client.post("/v1/surveys?site_id=hall&name=again", content=table(2_000))
        job_id = sent.raise_for_status().json()["job_id"]
        until(client, job_id, "running")
        hall.kill()
    hall.start()
    with hall.client() as client:
        done = ended(client, job_id)
        assert (done["state"], done["progress"]["fingerprints"]) == ("done", 2_000)
        surveys, active = stored(client)
        assert set(surveys) == {*before[0], done["result"]["survey_id"]}
        assert active == before[1]
