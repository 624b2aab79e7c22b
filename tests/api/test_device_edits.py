"""What an admin says of a device counts for what it posts from then on."""

from typing import Any

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record

pytestmark = pytest.mark.anyio

LOUDER_DB = 8.0


def louder(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record of a phone that hears everything louder."""
    beacons = [{**b, "rssi": b["rssi"] + LOUDER_DB} for b in record["beacons"]]
    return {**record, "beacons": beacons}


async def fix_of(server: ApiServer, record: dict[str, Any], **fields: object) -> dict[str, Any]:
    async with server.client("phone-7") as phone:
        reply = (await phone.post("/v1/ingest", json=batch(record, **fields))).json()
    reply["fix"].pop("time")
    return reply["fix"]


async def edit(server: ApiServer, **fields: object) -> None:
    async with server.client("admin") as admin:
        patch = {"Content-Type": "application/merge-patch+json"}
        reply = await admin.patch("/v1/devices/phone-7", json=fields, headers=patch)
        assert reply.status_code == 200, reply.text


async def test_a_devices_level_offset_is_taken_off_what_it_hears(server: ApiServer) -> None:
    heard = ble_record(6.0, 4.0, NOW_S * 1000.0)
    honest = await fix_of(server, heard, session="honest")
    loud = await fix_of(server, louder(heard), session="before")
    assert abs(loud["x"] - honest["x"]) + abs(loud["y"] - honest["y"]) > 0.1
    await edit(server, level_offset_db=LOUDER_DB)
    levelled = await fix_of(server, louder(heard), session="after")
    for field in ("x", "y", "radius95_m"):
        assert levelled[field] == pytest.approx(honest[field], abs=1e-6)


async def test_an_edited_level_offset_changes_nothing_that_was_posted(server: ApiServer) -> None:
    heard = louder(ble_record(6.0, 4.0, NOW_S * 1000.0))
    before = await fix_of(server, heard)
    await edit(server, level_offset_db=LOUDER_DB)
    registry = server.app.state.context.registry
    await registry.close()
    assert await fix_of(server, heard) == before


async def test_an_erased_device_comes_back_as_a_new_one(server: ApiServer) -> None:
    heard = ble_record(6.0, 4.0, NOW_S * 1000.0)
    body = batch(heard, site="lab", device={"id": "phone-7", "platform": "ios", "model": "15"})
    async with server.client("admin") as admin:
        for model in ("first", "second"):
            body["device"]["model"] = model
            assert (await admin.post("/v1/ingest", json=body)).status_code == 200
            await server.app.state.context.database.flush()
            device = (await admin.get("/v1/devices/phone-7")).json()
            assert (device["platform"], device["model"]) == ("ios", model)
            assert (await admin.delete("/v1/devices/phone-7")).status_code == 204


async def test_a_device_whose_site_is_gone_goes_to_the_only_one_left(server: ApiServer) -> None:
    heard = ble_record(6.0, 4.0, NOW_S * 1000.0)
    async with server.client("admin") as admin:
        there = await admin.post("/v1/ingest", json=batch(heard, site="annex"))
        assert there.status_code == 200
        assert (await admin.delete("/v1/sites/annex")).status_code == 204
        here = await admin.post("/v1/ingest", json=batch(heard, session="walk-2"))
    assert here.status_code == 200, here.text
    assert here.json()["fix"]["site_id"] == "lab"
