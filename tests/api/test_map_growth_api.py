"""Sessions at a site that opted in are kept aside, looked at, and accepted or discarded."""

from functools import partial
from typing import Any

import httpx
import numpy as np
import pytest
from api_server import ApiServer, batch, on_both_databases
from wifi_hall import levels_dbm, scan, walked

from app.core.fingerprint.growth import GROWN
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.types import Steps, WifiScan
from app.services.housekeeping import Housekeeping, Retention
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap, load_radio_map, save_radio_map

pytestmark = pytest.mark.anyio

GROWTH = "/v1/sites/lab/growth"
SIDE_M = 20.0
WALKS = 3


async def survey(server: ApiServer) -> StoredRadioMap:
    """Store a map of the room's left half."""
    grid = np.arange(0.0, SIDE_M / 2 + 1.0, 2.0)
    rows = [
        Fingerprint(0, x, y, levels_dbm(x, y), {}, f"line-{x:g}")
        for x in grid.tolist()
        for y in grid.tolist()
    ]
    save = partial(
        save_radio_map,
        site_id="lab",
        radio_map=build_radio_map(("lab-0",), rows),
        origin=RadioMapOrigin("left half", 0.0),
        activate=True,
    )
    stored: StoredRadioMap = await server.app.state.context.database.write(save)
    await server.app.state.context.directory.refresh()
    return stored


def record(observation: WifiScan | Steps, start_s: float) -> dict[str, object]:
    t_ms = round((start_s + observation.time_s - 1000.0) * 1000.0)
    if isinstance(observation, Steps):
        return {
            "k": "step",
            "t_ms": t_ms,
            "len_m": observation.step_length_m,
            "heading_deg": (90.0 - float(np.degrees(observation.heading_rad))) % 360.0,
        }
    aps = [
        {"bssid": reading.keys[0].removeprefix("mac:"), "rssi": reading.rssi_dbm}
        for reading in observation.readings
    ]
    return {"k": "wifi", "t_ms": t_ms, "aps": aps}


async def walk_through(server: ApiServer) -> None:
    """Let phones walk from the surveyed half into the other one, and their sessions end."""
    corners = [(2.0, 5.0), (18.0, 5.0), (18.0, 9.0), (2.0, 9.0)]
    start_s = server.clock.now_s()
    async with server.client("phone-7") as phone:
        for seed in range(WALKS):
            told = walked(corners, np.random.default_rng(seed), 28.0)
            records = [record(observation, start_s) for observation in told]
            body = batch(*records, session=f"walk-{seed}")
            reply = await phone.post("/v1/ingest", json=body)
            assert reply.status_code == 200, reply.text
            assert reply.json()["rejected"] == []
    server.clock.time_s += 3600.0


async def housekeep(server: ApiServer) -> None:
    context = server.app.state.context
    await Housekeeping(
        context.registry,
        context.directory,
        context.database,
        context.clock,
        Retention(),
        context.ageing,
    ).round()


async def opt_in(admin: httpx.AsyncClient) -> None:
    headers = {"Content-Type": "application/merge-patch+json"}
    reply = await admin.patch("/v1/sites/lab", json={"grow_map": True}, headers=headers)
    assert reply.status_code == 200, reply.text
    assert reply.json()["grow_map"] is True


async def look(server: ApiServer, admin: httpx.AsyncClient) -> dict[str, Any]:
    """Look at the growth of the lab's map, and return what the job tells."""
    begun = await admin.post(GROWTH)
    assert begun.status_code == 202, begun.text
    await server.app.state.context.growth.settle()
    job = (await admin.get(begun.headers["Location"])).json()
    assert (job["kind"], job["state"]) == ("map growth", "done"), job
    return dict(job["result"])


async def active_map(admin: httpx.AsyncClient) -> dict[str, Any]:
    reply = await admin.get("/v1/radio-maps", params={"site_id": "lab", "active": True})
    (only,) = reply.json()["items"]
    return dict(only)


async def grow_aside(server: ApiServer, admin: httpx.AsyncClient) -> None:
    """Let sessions of a site that opted in be taken aside."""
    await opt_in(admin)
    await walk_through(server)
    await housekeep(server)


async def test_nothing_is_kept_aside_where_nobody_opted_in(server: ApiServer) -> None:
    await survey(server)
    await walk_through(server)
    await housekeep(server)
    async with server.client() as admin:
        assert (await admin.get(GROWTH)).json()["waiting"] == 0


@on_both_databases
async def test_what_is_accepted_becomes_a_version_and_nothing_before(server: ApiServer) -> None:
    before = await survey(server)
    database = server.app.state.context.database
    async with server.client() as admin:
        await grow_aside(server, admin)
        assert (await admin.get(GROWTH)).json() == {"waiting": WALKS, "look": None}
        unseen = await admin.post(f"{GROWTH}/accept")
        assert (unseen.status_code, unseen.json()["code"]) == (409, "conflict")
        seen = await look(server, admin)
        told = (await admin.get(GROWTH)).json()["look"]
        assert told.pop("looked_at") == "2026-11-22T03:20:01.000Z"
        assert told == seen
        assert seen["sessions"] > 0
        assert seen["fingerprints"] == sum(place["fingerprints"] for place in seen["places"]) > 0
        assert seen["effect"]["scans"] > 0
        assert await active_map(admin) == {
            **(await active_map(admin)),
            "radio_map_id": before.radio_map_id,
            "fingerprints": before.fingerprints,
        }
        accepted = await admin.post(f"{GROWTH}/accept")
        assert accepted.status_code == 201, accepted.text
        grown = await active_map(admin)
        assert grown == accepted.json()
        assert grown["version"] == before.version + 1
        assert grown["fingerprints"] == before.fingerprints + seen["fingerprints"]
        assert grown["provenance"]["grown_from"] == before.radio_map_id
        # They are decided: neither offered again nor taken again.
        await housekeep(server)
        left = (await admin.get(GROWTH)).json()
        assert left == {"waiting": WALKS - seen["sessions"], "look": None}
        assert (await admin.post(f"{GROWTH}/accept")).status_code == 409
    kept = await database.read(partial(load_radio_map, radio_map_id=before.radio_map_id))
    assert not any(walk.startswith(GROWN) for walk in kept.survey_walks)


async def test_a_version_may_be_made_without_being_used(server: ApiServer) -> None:
    before = await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        await look(server, admin)
        made = (await admin.post(f"{GROWTH}/accept?activate=false")).json()
        assert made["active"] is False
        assert (await active_map(admin))["radio_map_id"] == before.radio_map_id


@on_both_databases
async def test_what_is_discarded_is_gone_and_not_taken_again(server: ApiServer) -> None:
    await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        await look(server, admin)
        assert (await admin.delete(GROWTH)).status_code == 204
        await housekeep(server)
        assert (await admin.get(GROWTH)).json() == {"waiting": 0, "look": None}
        nothing = {"sessions": 0, "fingerprints": 0, "places": [], "effect": None}
        assert await look(server, admin) == nothing
        assert (await admin.post(f"{GROWTH}/accept")).status_code == 409


@on_both_databases
async def test_what_is_kept_aside_goes_with_what_the_site_keeps_no_longer(
    server: ApiServer,
) -> None:
    await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        server.clock.time_s += 60 * 86_400.0
        await housekeep(server)
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS
        server.clock.time_s += 31 * 86_400.0
        await housekeep(server)
        assert (await admin.get(GROWTH)).json()["waiting"] == 0


async def test_what_has_changed_since_the_look_is_not_accepted(server: ApiServer) -> None:
    before = await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        await look(server, admin)
        # What the phone's owner wants forgotten must not come into the map by an older look.
        assert (await admin.delete("/v1/devices/phone-7")).status_code == 204
        refused = await admin.post(f"{GROWTH}/accept")
        assert (refused.status_code, refused.json()["code"]) == (409, "conflict")
        await admin.patch("/v1/beacons/b1", json={"name": "door"})
        assert (await admin.get(GROWTH)).json() == {"waiting": 0, "look": None}
        assert (await active_map(admin))["radio_map_id"] == before.radio_map_id


async def walk_on(server: ApiServer, **envelope: object) -> None:
    """Post some more scans, and let their session be taken aside."""
    later = [record(scan(1000.0 + i, 4.0, 5.0), server.clock.now_s()) for i in range(3)]
    async with server.client("phone-7") as phone:
        reply = await phone.post("/v1/ingest", json=batch(*later, **envelope))
        assert reply.status_code == 200, reply.text
    server.clock.time_s += 3600.0
    await housekeep(server)


async def test_a_look_at_a_session_that_went_on_since_is_not_accepted(server: ApiServer) -> None:
    before = await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        seen = await look(server, admin)
        await walk_on(server, seq=1, session="walk-0")
        # As many as before under the same ids, and not the same.
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS
        refused = await admin.post(f"{GROWTH}/accept")
        assert (refused.status_code, refused.json()["code"]) == (409, "conflict")
        again = await look(server, admin)
        assert again["fingerprints"] > seen["fingerprints"]
        accepted = (await admin.post(f"{GROWTH}/accept")).json()
        assert accepted["fingerprints"] == before.fingerprints + again["fingerprints"]


async def test_what_was_taken_aside_since_the_look_waits_for_the_next(server: ApiServer) -> None:
    await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        seen = await look(server, admin)
        await walk_on(server, session="walk-9")
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS + 1
        assert (await admin.post(f"{GROWTH}/accept")).status_code == 201
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS + 1 - seen["sessions"]


async def test_a_session_that_goes_on_is_taken_aside_anew(server: ApiServer) -> None:
    await survey(server)
    async with server.client() as admin:
        await grow_aside(server, admin)
        later = record(scan(1000.0, 4.0, 5.0), server.clock.now_s())
        async with server.client("phone-7") as phone:
            reply = await phone.post("/v1/ingest", json=batch(later, seq=1, session="walk-0"))
            assert reply.status_code == 200, reply.text
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS - 1
        server.clock.time_s += 3600.0
        await housekeep(server)
        assert (await admin.get(GROWTH)).json()["waiting"] == WALKS


async def test_only_admins_of_the_site_may_look(server: ApiServer) -> None:
    async with server.client() as admin:
        seen = await look(server, admin)
        (shown,) = (await admin.get("/v1/jobs?kind=map%20growth")).json()["items"]
        assert shown["result"] == seen
    async with server.client("viewer") as viewer:
        (hidden,) = (await viewer.get("/v1/jobs?kind=map%20growth")).json()["items"]
        assert hidden == {**shown, "result": None}
        assert (await viewer.get(f"/v1/jobs/{shown['job_id']}")).json() == hidden
        assert (await viewer.get(GROWTH)).status_code == 403
        assert (await viewer.post(GROWTH)).status_code == 403
    async with server.client() as admin:
        assert (await admin.get("/v1/sites/nowhere/growth")).status_code == 404
        assert (await admin.post("/v1/sites/nowhere/growth")).status_code == 404
