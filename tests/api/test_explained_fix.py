"""A fix explains itself when it is asked to, as documented."""

import math
from typing import Any

import pytest
from api_server import BEACONS, NOW_S, UUID, ApiServer, batch, ble_record

pytestmark = pytest.mark.anyio

FIX = "/v1/devices/phone-7/fix"


async def post(server: ApiServer, *records: dict[str, Any], seq: int = 0) -> dict[str, Any]:
    async with server.client("phone-7") as phone:
        reply = await phone.post("/v1/ingest", json=batch(*records, seq=seq, site="lab"))
    assert reply.status_code == 200, reply.text
    return reply.json()


async def explained(server: ApiServer) -> dict[str, Any]:
    async with server.client("phone-7") as phone:
        reply = await phone.get(FIX, params={"explain": "1"})
    assert reply.status_code == 200, reply.text
    return reply.json()


async def test_a_fix_tells_the_residual_of_every_beacon(server: ApiServer) -> None:
    heard = ble_record(6.0, 4.0, NOW_S * 1000.0)
    heard["beacons"].append({"mac": "a4c138000099", "rssi": -60})
    posted = await post(server, heard)
    told = await explained(server)
    assert told["fix"] == posted["fix"]
    why = told["explanation"]
    assert (why["means"], why["scan_time"]) == ("lateration", posted["fix"]["time"])
    by_key = {one["key"]: one for one in why["transmitters"]}
    assert by_key.pop("mac:a4c138000099")["use"] == "unknown"
    assert len(by_key) == len(BEACONS)
    for minor, (x_m, y_m) in BEACONS.items():
        one = by_key[f"ibeacon:{UUID}:1:{minor}"]
        place = (told["fix"]["x"], told["fix"]["y"])
        distance_m = math.dist((x_m, y_m, 2.7), (*place, 0.0))
        expected_dbm = -59.0 - 20.0 * math.log10(distance_m)
        assert (one["beacon_id"], one["kind"], one["use"]) == (f"b{minor}", "ble", "used")
        assert one["expected_dbm"] == pytest.approx(expected_dbm)
        assert one["residual_db"] == pytest.approx(one["heard_dbm"] - expected_dbm)
    assert why["floors"] == [{"floor_id": "lab-0", "vote_share": 1.0, "probability": 1.0}]
    assert why["motion"]["decided_by"] == "levels"
    assert why["faults"] == []
    schema = server.app.openapi()["components"]["schemas"]["Explanation"]
    assert set(schema["required"]) == set(why)
    parts = {"transmitters": why["transmitters"][0], "candidates": why["candidates"][0]}
    for name, part in parts.items():
        assert set(schema["properties"][name]["items"]["required"]) == set(part)
    assert set(schema["properties"]["motion"]["required"]) == set(why["motion"])


async def test_only_who_asks_is_told(server: ApiServer) -> None:
    await post(server, ble_record(6.0, 4.0, NOW_S * 1000.0))
    async with server.client("viewer") as viewer:
        assert "explanation" not in (await viewer.get(FIX)).json()
        assert "explanation" not in (await viewer.get(FIX, params={"explain": "0"})).json()
        assert (await viewer.get(FIX, params={"explain": "why"})).status_code == 422


async def test_no_fix_tells_what_was_heard(server: ApiServer) -> None:
    beacons = [{"mac": "a4c138000099", "rssi": -60}]
    await post(server, {"k": "ble", "t_ms": NOW_S * 1000.0, "beacons": beacons})
    told = await explained(server)
    assert told["fix"] is None
    assert told["no_fix"]["reason"] == "unknown_transmitters"
    assert told["explanation"]["means"] is None
    assert [one["use"] for one in told["explanation"]["transmitters"]] == ["unknown"]


async def test_an_explanation_outlives_a_restart_and_ends_with_its_session(
    server: ApiServer,
) -> None:
    for second in range(12):
        heard = ble_record(6.0, 4.0, (NOW_S + second) * 1000.0)
        await post(server, heard, seq=second)
    before = await explained(server)
    assert before["explanation"]["gate"]["inlier_probability"] > 0.7
    registry = server.app.state.context.registry
    await registry.close()
    assert await explained(server) == before
    server.clock.time_s += 3600.0
    await registry.sweep()
    after = await explained(server)
    assert after["explanation"] is None
    assert after["fix"] is not None
