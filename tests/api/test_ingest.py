"""POST /v1/ingest: what is accepted, what comes back, what a retry changes."""

import gzip
import json

import pytest
from api_server import NOW_S, UUID, ApiServer, batch, ble_record

from app.api.ingest_openapi import LOCATE_EXAMPLE, MOTION_EXAMPLE, WIFI_EXAMPLE

pytestmark = pytest.mark.anyio

NOW_MS = NOW_S * 1000.0


async def test_a_scan_comes_back_as_a_fix(server: ApiServer) -> None:
    async with server.client("phone-7") as client:
        reply = await client.post("/v1/ingest", json=batch(ble_record(6.0, 4.0, NOW_MS - 500)))
    assert reply.status_code == 200
    answer = reply.json()
    assert (answer["accepted"], answer["rejected"], answer["ignored"]) == (1, [], 0)
    fix = answer["fix"]
    assert "no_fix" not in answer
    assert fix["x"] == pytest.approx(6.0, abs=1.5)
    assert fix["y"] == pytest.approx(4.0, abs=1.0)
    assert (fix["device_id"], fix["site_id"], fix["floor_id"]) == ("phone-7", "lab", "lab-0")
    assert fix["time"] == "2026-11-22T02:20:00.500Z"
    assert fix["used"]["beacons"] == 5
    assert fix["method"] == "lateration"
    assert fix["covariance"][0][1] == fix["covariance"][1][0]
    assert answer["server_ms"] == NOW_MS


async def test_nothing_known_heard_is_no_fix_with_a_reason(server: ApiServer) -> None:
    stranger = {"mac": "c2:00:00:00:00:01", "rssi": -60}
    record = {"k": "ble", "t_ms": NOW_MS, "beacons": [stranger]}
    async with server.client("phone-7") as client:
        answer = (await client.post("/v1/ingest", json=batch(record))).json()
        assert answer["fix"] is None
        assert answer["no_fix"]["reason"] in {"unknown_transmitters", "not_started"}
        empty = (await client.post("/v1/ingest", json=batch(seq=1))).json()
    assert empty["accepted"] == 0
    assert empty["fix"] is None


async def test_a_retry_with_another_send_time_is_the_same_batch(server: ApiServer) -> None:
    record = ble_record(6.0, 4.0, NOW_MS)
    async with server.client("phone-7") as client:
        first = await client.post("/v1/ingest", json=batch(record, clock={"sent_ms": NOW_MS}))
        spaced = json.dumps(batch(dict(reversed(record.items())), clock={"sent_ms": NOW_MS + 900}))
        again = await client.post(
            "/v1/ingest", content=spaced, headers={"Content-Type": "application/json"}
        )
    assert first.json()["duplicate"] is False
    assert again.json()["duplicate"] is True
    assert again.json()["accepted"] == 1
    assert again.json()["fix"] == first.json()["fix"]


async def test_other_records_under_the_same_seq_are_a_conflict(server: ApiServer) -> None:
    async with server.client("phone-7") as client:
        await client.post("/v1/ingest", json=batch(ble_record(6.0, 4.0, NOW_MS)))
        other = await client.post("/v1/ingest", json=batch(ble_record(7.0, 4.0, NOW_MS)))
    assert (other.status_code, other.json()["code"]) == (409, "seq_conflict")


async def test_another_boot_in_the_same_session_is_refused(server: ApiServer) -> None:
    async with server.client("phone-7") as client:
        await client.post("/v1/ingest", json=batch(clock={"boot_id": "boot-1"}))
        other = await client.post("/v1/ingest", json=batch(seq=1, clock={"boot_id": "boot-2"}))
    assert (other.status_code, other.json()["code"]) == (409, "clock_changed")


async def test_gzip_bodies_of_several_members_are_read(server: ApiServer) -> None:
    body = json.dumps(batch(ble_record(6.0, 4.0, NOW_MS))).encode()
    packed = gzip.compress(body[:50]) + gzip.compress(body[50:])
    headers = {"Content-Encoding": "gzip", "Content-Type": "application/json; charset=utf-8"}
    async with server.client("phone-7") as client:
        reply = await client.post("/v1/ingest", content=packed, headers=headers)
    assert reply.json()["accepted"] == 1


async def test_monotonic_times_are_mapped_by_the_first_batch(server: ApiServer) -> None:
    record = ble_record(6.0, 4.0, 0)
    del record["t_ms"]
    clock = {"sent_ms": NOW_MS, "mono_ms": 5_000_000.0, "boot_id": "b"}
    async with server.client("phone-7") as client:
        body = batch({**record, "mono_ms": 4_999_000.0}, clock=clock)
        answer = (await client.post("/v1/ingest", json=body)).json()
    assert answer["fix"]["time"] == "2026-11-22T02:20:00.000Z"


async def test_monotonic_times_wait_for_the_batch_that_tells_the_clock(server: ApiServer) -> None:
    record = ble_record(6.0, 4.0, 0)
    del record["t_ms"]
    clock = {"sent_ms": NOW_MS, "mono_ms": 5_000_000.0}
    async with server.client("phone-7") as client:
        body = batch({**record, "mono_ms": 4_999_500.0}, seq=1)
        first = (await client.post("/v1/ingest", json=body)).json()
        assert (first["accepted"], first["waiting"], first["rejected"]) == (1, 1, [])
        assert (first["fix"], first["no_fix"]["reason"]) == (None, "nothing_observed")
        body = batch({**record, "mono_ms": 4_999_000.0}, clock=clock)
        answer = (await client.post("/v1/ingest", json=body)).json()
        assert (answer["accepted"], answer["waiting"]) == (1, 0)
        assert answer["fix"]["time"] == "2026-11-22T02:20:00.500Z"
        body = batch({**record, "mono_ms": 5000}, session="walk-2")
        assert (await client.post("/v1/ingest", json=body)).json()["waiting"] == 1
        server.clock.time_s += 61
        body = batch({**record, "mono_ms": 6000}, session="walk-2", seq=1)
        told = (await client.post("/v1/ingest", json=body)).json()
    assert (told["accepted"], told["waiting"]) == (0, 0)
    assert [(r["i"], r["code"]) for r in told["rejected"]] == [(0, "no_clock")]


async def test_a_phone_clock_that_is_wrong_is_set_right(server: ApiServer) -> None:
    hour_ms = 3_600_000.0
    body = batch(ble_record(6.0, 4.0, NOW_MS - hour_ms), clock={"sent_ms": NOW_MS - hour_ms})
    async with server.client("phone-7") as client:
        answer = (await client.post("/v1/ingest", json=body)).json()
    assert answer["fix"]["time"] == "2026-11-22T02:20:01.000Z"


async def test_recordings_keep_their_times_and_need_a_surveyor(server: ApiServer) -> None:
    body = batch(ble_record(6.0, 4.0, 1_500_000_000_000), clock={"mode": "recorded"}, site="lab")
    async with server.client("phone-7") as client:
        refused = await client.post("/v1/ingest", json=body)
    assert (refused.status_code, refused.json()["code"]) == (403, "role_forbidden")
    async with server.client("surveyor") as client:
        answer = (await client.post("/v1/ingest", json=body)).json()
    assert answer["fix"]["time"] == "2017-07-14T02:40:00.000Z"


async def test_truth_is_taken_from_surveyors_only(server: ApiServer) -> None:
    truth = {"k": "truth", "t_ms": NOW_MS, "x": 1.0, "y": 2.0, "floor_id": "lab-0"}
    async with server.client("phone-7") as client:
        refused = (await client.post("/v1/ingest", json=batch(truth))).json()
    assert [r["code"] for r in refused["rejected"]] == ["role_forbidden"]
    async with server.client("surveyor") as client:
        taken = (await client.post("/v1/ingest", json=batch(truth, seq=1))).json()
    assert taken["accepted"] == 1


async def test_kinds_that_are_not_used_are_counted(server: ApiServer) -> None:
    rtt = {"k": "rtt", "t_ms": NOW_MS, "ranges": []}
    fix = {"k": "fix", "t_ms": NOW_MS, "lat": 0, "lon": 0}
    async with server.client("phone-7") as client:
        answer = (await client.post("/v1/ingest", json=batch(rtt, fix, {"k": "tea"}))).json()
    assert (answer["accepted"], answer["ignored"], answer["rejected"]) == (0, 3, [])


async def test_a_prefix_token_enrols_devices(server: ApiServer) -> None:
    body = batch(ble_record(6.0, 4.0, NOW_MS), device={"id": "fleet-12", "model": "Pixel 8"})
    async with server.client("fleet") as client:
        assert (await client.post("/v1/ingest", json=body)).json()["fix"]["site_id"] == "lab"
    await server.app.state.context.database.flush()
    async with server.client("admin") as client:
        device = (await client.get("/v1/devices/fleet-12")).json()
    assert device["model"] == "Pixel 8"


async def test_the_site_is_the_bodys_then_the_devices(server: ApiServer) -> None:
    async with server.client("admin") as client:
        open_question = await client.post("/v1/ingest", json=batch())
        assert (open_question.status_code, open_question.json()["code"]) == (422, "site_required")
        assert (await client.post("/v1/ingest", json=batch(site="lab"))).is_success
        scan = ble_record(6.0, 4.0, NOW_MS)
        known = await client.post("/v1/ingest", json=batch(scan, session="walk-2"))
    assert known.json()["fix"]["site_id"] == "lab"


@pytest.mark.parametrize("example", [WIFI_EXAMPLE, MOTION_EXAMPLE])
async def test_the_documented_examples_work(server: ApiServer, example: dict[str, object]) -> None:
    async with server.client("admin") as client:
        reply = await client.post("/v1/ingest", json={**example, "site": "lab"})
    assert reply.status_code == 200
    assert reply.json()["accepted"] == len(example["records"])  # type: ignore[arg-type]


async def test_locate_answers_without_storing(server: ApiServer) -> None:
    body = {"site": "lab", "records": [ble_record(6.0, 4.0, NOW_MS)]}
    async with server.client("viewer") as client:
        answer = (await client.post("/v1/locate", json=body)).json()
        assert answer["fix"]["x"] == pytest.approx(6.0, abs=1.5)
        assert answer["fix"]["device_id"] is None
        best = answer["alternatives"][0]
        assert (best["floor_id"], best["weight"]) == ("lab-0", pytest.approx(1.0))
        assert (await client.get("/v1/devices")).json()["items"] == []
        example = await client.post("/v1/locate", json={**LOCATE_EXAMPLE, "site": "lab"})
        assert example.status_code == 200


async def test_a_phone_learns_what_it_needs(server: ApiServer) -> None:
    async with server.client("phone-7") as client:
        assert (await client.get("/v1/time")).json() == {"t1_ms": NOW_MS, "t2_ms": NOW_MS}
        uuids = (await client.get("/v1/beacons/uuids")).json()
        assert uuids == {"site_id": "lab", "uuids": [UUID]}
        assert (await client.get("/v1/config")).json()["max_records"] == 5000
