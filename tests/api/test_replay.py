"""A stored session runs again: the same track, or what another profile or map would have said."""

import asyncio
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record
from sqlalchemy import Connection

from app.core.engine import PROFILES
from app.core.fingerprint.ageing import Change, Suspect
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.services import replay as replay_service
from app.storage import ageing
from app.storage.radio_maps import RadioMapOrigin, save_radio_map

pytestmark = pytest.mark.anyio

REPLAY = "/v1/devices/phone-7/replay"
SECONDS = 8


async def walk(server: ApiServer, session: str = "walk-1", **fields: object) -> None:
    async with server.client("phone-7") as phone:
        for seq in range(SECONDS):
            heard = ble_record(4.0 + seq, 4.0, (NOW_S + seq) * 1000.0)
            body = batch(heard, seq=seq, session=session, **fields)
            assert (await phone.post("/v1/ingest", json=body)).status_code == 200


async def track(server: ApiServer) -> list[dict[str, Any]]:
    async with server.client("viewer") as viewer:
        return (await viewer.get("/v1/devices/phone-7/track")).json()["items"]


async def replayed(server: ApiServer, **body: object) -> list[dict[str, Any]]:
    async with server.client("viewer") as viewer:
        reply = await viewer.post(REPLAY, json=body)
    assert reply.status_code == 200, reply.text
    assert reply.json()["next_cursor"] is None
    return reply.json()["items"]


async def end_sessions(server: ApiServer) -> None:
    server.clock.time_s += 3600.0
    await server.app.state.context.registry.sweep()


@pytest.fixture
def other(monkeypatch: pytest.MonkeyPatch) -> str:
    best = PROFILES["best"]
    lateration = replace(best.params.lateration, correlation_m=20.0)
    params = replace(best.params, profile="other", lateration=lateration)
    monkeypatch.setitem(PROFILES, "other", replace(best, params=params))
    return "other"


async def test_a_replay_is_the_track_that_is_stored_at_the_end(server: ApiServer) -> None:
    await walk(server)
    before = await replayed(server)
    await end_sessions(server)
    stored = await track(server)
    assert len(stored) == SECONDS
    assert before == await replayed(server, session="walk-1") == stored


async def test_a_track_tells_whether_it_is_causal_or_smoothed(server: ApiServer) -> None:
    """Smoothed once its session is over; causal again when the phone comes back to it."""

    async def kinds() -> list[tuple[str, str]]:
        async with server.client("viewer") as viewer:
            reply = (await viewer.get("/v1/devices/phone-7/track")).json()
            text = await viewer.get("/v1/devices/phone-7/track", headers={"Accept": "text/csv"})
        rows = [row.split(",") for row in text.text.splitlines()]
        assert {row[rows[0].index("kind")] for row in rows[1:]} == {
            session["kind"] for session in reply["sessions"]
        }
        times = [item["time"] for item in reply["items"]]
        assert (reply["sessions"][0]["first"], reply["sessions"][-1]["last"]) == (
            times[0],
            times[-1],
        )
        assert sum(session["points"] for session in reply["sessions"]) == len(times)
        return [(session["session"], session["kind"]) for session in reply["sessions"]]

    await walk(server)
    assert await kinds() == [("walk-1", "causal")]
    await end_sessions(server)
    assert await kinds() == [("walk-1", "smoothed")]
    async with server.client("viewer") as viewer:
        (told,) = (await viewer.post(REPLAY, json={})).json()["sessions"]
    assert (told["session"], told["kind"], told["points"]) == ("walk-1", "smoothed", SECONDS)
    async with server.client("phone-7") as phone:
        more = ble_record(6.0, 4.0, (NOW_S + SECONDS) * 1000.0)
        reply = await phone.post("/v1/ingest", json=batch(more, seq=SECONDS))
    assert reply.status_code == 200, reply.text
    assert await kinds() == [("walk-1", "causal")]


async def test_another_profile_tells_another_track_and_changes_nothing(
    server: ApiServer, other: str
) -> None:
    await walk(server)
    await end_sessions(server)
    stored = await track(server)
    told = await replayed(server, profile=other)
    assert {point["profile"] for point in told} == {other}
    assert [point["x"] for point in told] != [point["x"] for point in stored]
    assert await track(server) == stored
    # It is the track of a session that had this profile from the start.
    await walk(server, session="walk-2", profile=other)
    assert await replayed(server) == told


async def test_another_radio_map_is_put_in_place_of_the_sites(server: ApiServer) -> None:
    heard_dbm = {f"mac:0242ac1100{i:02}": -50.0 - i for i in range(4)}
    radio_map = build_radio_map(("lab-0",), [Fingerprint(0, 7.0, 9.0, heard_dbm, {})])
    ids = {}
    for site_id in ("lab", "annex"):
        save = partial(
            save_radio_map,
            site_id=site_id,
            radio_map=radio_map,
            origin=RadioMapOrigin("m", 0.0),
            activate=False,
        )
        stored = await server.app.state.context.database.write(save)
        ids[site_id] = stored.radio_map_id
    aps = [{"bssid": key.removeprefix("mac:"), "rssi": dbm} for key, dbm in heard_dbm.items()]
    async with server.client("phone-7") as phone:
        body = batch({"k": "wifi", "t_ms": NOW_S * 1000.0, "aps": aps})
        assert (await phone.post("/v1/ingest", json=body)).json()["fix"] is None
    async with server.client("viewer") as viewer:
        foreign = await viewer.post(REPLAY, json={"radio_map": ids["annex"]})
    (told,) = await replayed(server, radio_map=ids["lab"])
    assert told["method"] == "fingerprint"
    assert (told["x"], told["y"]) == pytest.approx((7.0, 9.0))
    assert await replayed(server) == []
    assert foreign.status_code == 422
    assert foreign.json()["errors"][0]["pointer"] == "#/radio_map"


async def test_a_named_radio_map_is_matched_without_what_is_quarantined_of_it(
    server: ApiServer,
) -> None:
    levels_dbm = {f"mac:0242ac1100{i:02}": -50.0 - i for i in range(4)}
    surveyed = [Fingerprint(0, 7.0, 9.0, levels_dbm, {})]

    def store(connection: Connection) -> str:
        radio_map = build_radio_map(("lab-0",), surveyed)
        origin = RadioMapOrigin("m", 0.0)
        stored = save_radio_map(connection, "lab", radio_map, origin, activate=False)
        aged = [Suspect(key, Change.MOVED, 1.0, 9, 9, 9.0) for key in levels_dbm]
        ageing.replace_suspects(connection, stored.radio_map_id, aged, NOW_S)
        return stored.radio_map_id

    database = server.app.state.context.database
    radio_map_id = await database.write(store)
    aps = [{"bssid": key.removeprefix("mac:"), "rssi": dbm} for key, dbm in levels_dbm.items()]
    async with server.client("phone-7") as phone:
        await phone.post("/v1/ingest", json=batch({"k": "wifi", "t_ms": NOW_S * 1e3, "aps": aps}))
    assert len(await replayed(server, radio_map=radio_map_id)) == 1
    held = partial(ageing.set_quarantine, radio_map_id=radio_map_id, keys=list(levels_dbm))
    await database.write(partial(held, quarantined=True))
    assert await replayed(server, radio_map=radio_map_id) == []


@pytest.mark.parametrize(
    ("body", "status", "pointer"),
    [
        ({"session": "never"}, 404, None),
        ({"profile": "none"}, 422, "#/profile"),
        ({"radio_map": "none"}, 422, "#/radio_map"),
        ({"speed": 2}, 422, "#/speed"),
    ],
)
async def test_what_cannot_be_run_is_refused(
    server: ApiServer, body: dict[str, Any], status: int, pointer: str | None
) -> None:
    await walk(server)
    async with server.client("viewer") as viewer:
        reply = await viewer.post(REPLAY, json=body)
    assert reply.status_code == status
    if pointer is not None:
        assert [error["pointer"] for error in reply.json()["errors"]] == [pointer]


async def test_a_replay_is_bounded(server: ApiServer, monkeypatch: pytest.MonkeyPatch) -> None:
    await walk(server)
    async with server.client("viewer") as viewer:
        together = await asyncio.gather(*(viewer.post(REPLAY, json={}) for _ in range(2)))
        assert sorted(reply.status_code for reply in together) == [200, 429]
        monkeypatch.setattr(replay_service, "MAX_REPLAY_BYTES", 100)
        long = await viewer.post(REPLAY, json={})
    assert (long.status_code, long.json()["errors"][0]["pointer"]) == (422, "#/session")


async def test_a_replay_comes_in_the_form_that_is_asked_for(server: ApiServer) -> None:
    await walk(server)
    async with server.client("viewer") as viewer:
        table = await viewer.post(REPLAY, json={}, headers={"Accept": "text/csv"})
        globe = await viewer.post(REPLAY, json={}, headers={"Accept": "application/geo+json"})
    assert table.text.count("\n") == SECONDS + 1
    assert globe.json()["code"] == "no_georeference"
