"""Last heard and battery of beacons: from traffic to the registry, and never into positions."""

import csv
import io
import sqlite3
from contextlib import closing

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record, serving
from httpx import AsyncClient
from server_process import PATIENCE

from app.config import Settings
from app.main import create_app

pytestmark = pytest.mark.anyio

NOW_MS = NOW_S * 1000.0
TLM = "20000bb815800000000a00000064"
RECORDED = {"clock": {"mode": "recorded"}}


def told(record: dict, beacon: int, **fields: object) -> dict:
    record["beacons"][beacon - 1].update(fields)
    return record


async def post(client: AsyncClient, *records: dict, **fields: object) -> dict:
    reply = await client.post("/v1/ingest", json=batch(*records, site="lab", **fields))
    assert reply.status_code == 200, reply.text
    assert reply.json()["rejected"] == []
    return reply.json()


async def beacon(client: AsyncClient, beacon_id: str) -> dict:
    return (await client.get(f"/v1/beacons/{beacon_id}")).json()


async def test_a_beacon_tells_when_it_was_last_heard(server: ApiServer) -> None:
    async with server.client() as admin:
        assert (await beacon(admin, "b1"))["last_heard_at"] is None
        await post(admin, told(ble_record(6.0, 4.0, NOW_MS - 2000.0), 2, age_ms=1500), seq=0)
        # What is older changes nothing, nor does what no registered beacon sent.
        stranger = {"k": "ble", "t_ms": NOW_MS, "beacons": [{"mac": "a4c138000009", "rssi": -60}]}
        await post(admin, ble_record(6.0, 4.0, NOW_MS - 9000.0), stranger, seq=1)
        listed = (await admin.get("/v1/beacons")).json()["items"]
    heard = {each["beacon_id"]: each["last_heard_at"] for each in listed}
    assert heard["b1"] == "2026-11-22T02:19:59.000Z"
    assert heard["b2"] == "2026-11-22T02:19:57.500Z"
    assert all(each["battery"] is None for each in listed)


async def test_telemetry_is_kept_by_its_time_and_field_by_field(server: ApiServer) -> None:
    async with server.client() as admin:
        percent = {"battery_percent": 83, "battery_mv": 0, "temperature_c": -128}
        await post(admin, told(ble_record(6, 4, NOW_MS - 3000), 1, telemetry=percent), seq=0)
        await post(admin, told(ble_record(6, 4, NOW_MS - 1000), 1, tlm=TLM), seq=1)
        assert (await beacon(admin, "b1"))["battery"] == {
            "percent": 83.0,
            "voltage_v": 3.0,
            "temperature_c": 21.5,
            "told_at": "2026-11-22T02:20:00.000Z",
        }
        older = {"battery_mv": 2500, "temperature_c": 30.0}
        await post(admin, told(ble_record(6, 4, NOW_MS - 2000), 1, telemetry=older), seq=2)
        told_last = await beacon(admin, "b1")
        assert told_last["battery"]["voltage_v"] == 3.0
        assert told_last["battery"]["temperature_c"] == 21.5


async def test_telemetry_changes_neither_positions_nor_etags(server: ApiServer) -> None:
    async with server.client() as admin:
        before = (await admin.get("/v1/beacons/b1")).headers["ETag"]
        fixes = []
        for session, extra in (("plain", {}), ("telling", {"tlm": TLM, "telemetry": None})):
            record = ble_record(6.0, 4.0, NOW_MS)
            for each in record["beacons"]:
                each.update(extra)
            fixes.append((await post(admin, record, session=session, **RECORDED))["fix"])
        assert fixes[0] == fixes[1]
        assert fixes[0] is not None
        reply = await admin.get("/v1/beacons/b1", headers={"If-None-Match": before})
        assert reply.status_code == 304


async def test_wrong_telemetry_is_refused_with_its_place(server: ApiServer) -> None:
    wrong = [
        told(ble_record(6, 4, NOW_MS), 2, telemetry={"battery_percent": 130}),
        told(ble_record(6, 4, NOW_MS), 2, tlm="2000"),
    ]
    async with server.client() as admin:
        reply = await admin.post("/v1/ingest", json=batch(*wrong, site="lab"))
    assert [(r["code"], r["pointer"]) for r in reply.json()["rejected"]] == [
        ("out_of_range", "#/records/0/beacons/1/telemetry/battery_percent"),
        ("wrong_format", "#/records/1/beacons/1/tlm"),
    ]


async def test_beacons_not_heard_since_can_be_listed(server: ApiServer) -> None:
    async with server.client() as admin:
        partly = ble_record(6.0, 4.0, NOW_MS - 60_000)
        await post(admin, partly, seq=0)
        fresh = ble_record(6.0, 4.0, NOW_MS)
        fresh["beacons"] = fresh["beacons"][:3]
        await post(admin, fresh, seq=1)
        new = {"beacon_id": "new", "site_id": "lab", "kind": "ble", "keys": ["mac:a4c138000077"]}
        assert (await admin.post("/v1/beacons", json=new)).status_code == 201
        params = {"site_id": "lab", "not_heard_since": "2026-11-22T02:20:00Z"}
        silent = (await admin.get("/v1/beacons", params=params)).json()["items"]
        assert [each["beacon_id"] for each in silent] == ["b4", "b5", "new"]
        params["not_heard_since"] = "yesterday"
        assert (await admin.get("/v1/beacons", params=params)).status_code == 422


async def test_a_beacon_by_any_of_its_keys_placed_or_not(server: ApiServer) -> None:
    async with server.client() as admin:
        keys = ["eddystone:00112233445566778899:aabbccddeeff", "mac:a4c138000077"]
        new = {"beacon_id": "new", "site_id": "lab", "kind": "ble", "keys": keys}
        await admin.post("/v1/beacons", json=new)
        heard = [{"mac": "a4:c1:38:00:00:77", "rssi": 0, "tlm": TLM}]
        await post(admin, {"k": "ble", "t_ms": NOW_MS, "beacons": heard})
        found = await beacon(admin, "new")
    assert found["last_heard_at"] == found["battery"]["told_at"] == "2026-11-22T02:20:01.000Z"


async def test_exports_tell_it_and_imports_pass_it_over(server: ApiServer) -> None:
    async with server.client() as admin:
        await post(admin, told(ble_record(6.0, 4.0, NOW_MS), 1, tlm=TLM))
        for media_type in ("text/csv", "application/json"):
            exported = await admin.get(
                "/v1/beacons/export", params={"site_id": "lab"}, headers={"Accept": media_type}
            )
            reply = await admin.post(
                "/v1/beacons/import",
                params={"site_id": "lab"},
                content=exported.content,
                headers={"Content-Type": media_type},
            )
            assert (reply.json()["unchanged"], reply.json()["refused"]) == (5, [])
            if media_type == "text/csv":
                rows = list(csv.DictReader(io.StringIO(exported.text)))
                first = {name: rows[0][name] for name in ("last_heard_at", "battery_v")}
                assert first == {"last_heard_at": "2026-11-22T02:20:01.000Z", "battery_v": "3.0"}
                assert rows[0]["temperature_c"] == "21.5"
                assert rows[1]["battery_v"] == ""


async def test_while_no_write_is_taken_what_is_stored_is_read(
    server: ApiServer, database_url: str
) -> None:
    async with server.client() as admin:
        await post(admin, ble_record(6.0, 4.0, NOW_MS - 9000.0), seq=0)
        before = (await admin.get("/v1/beacons")).json()
        await post(admin, ble_record(6.0, 4.0, NOW_MS), seq=1)
        with closing(sqlite3.connect(database_url.removeprefix("sqlite:///"))) as other:
            other.execute("BEGIN IMMEDIATE")
            listed = await admin.get("/v1/beacons")
            one = await admin.get("/v1/beacons/b1")
            exported = await admin.get("/v1/beacons/export?site_id=lab")
        assert [reply.status_code for reply in (listed, one, exported)] == [200] * 3
        assert listed.json() == before
        assert one.json() == before["items"][0]
        # Nothing was forgotten meanwhile.
        await server.app.state.context.watch.flush()
        assert (await beacon(admin, "b1"))["last_heard_at"] == "2026-11-22T02:20:01.000Z"


async def test_it_outlives_a_restart_without_anybody_having_asked(database_url: str) -> None:
    async with serving(database_url) as server, server.client() as admin:
        await post(admin, told(ble_record(6.0, 4.0, NOW_MS), 1, tlm=TLM))
    server.app = create_app(Settings(database_url=database_url, **PATIENCE), server.clock)
    async with server.app.router.lifespan_context(server.app), server.client() as admin:
        found = await beacon(admin, "b1")
        assert found["last_heard_at"] == "2026-11-22T02:20:01.000Z"
        assert found["battery"]["voltage_v"] == 3.0
        # An older reading after the restart does not turn it back.
        await post(admin, ble_record(6.0, 4.0, NOW_MS - 5000.0), seq=1)
        assert (await beacon(admin, "b1"))["last_heard_at"] == found["last_heard_at"]
