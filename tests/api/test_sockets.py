"""WS /v1/ingest/stream and WS /v1/stream behind a real uvicorn."""

import asyncio
import contextlib
import json
import sqlite3
from collections.abc import AsyncIterator
from typing import Any

import pytest
from api_server import NOW_S, batch, ble_record
from live_server import LiveServer, listening
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

pytestmark = pytest.mark.anyio

NOW_MS = NOW_S * 1000.0


@pytest.fixture
async def live(database_url: str, anyio_backend: str) -> AsyncIterator[LiveServer]:
    async with listening(database_url) as server:
        yield server


async def ask(socket: ClientConnection, frame: object) -> dict[str, Any]:
    await socket.send(frame if isinstance(frame, str) else json.dumps(frame))
    return await hear(socket)


async def hear(socket: ClientConnection) -> dict[str, Any]:
    async with asyncio.timeout(10):
        heard: dict[str, Any] = json.loads(await socket.recv())
    return heard


async def closing(socket: ClientConnection) -> tuple[int | None, str]:
    async with asyncio.timeout(10):
        with contextlib.suppress(ConnectionClosed):
            async for _ in socket:
                pass
    return socket.close_code, socket.close_reason or ""


async def post(live: LiveServer, body: dict[str, Any], bearer: str = "admin") -> dict[str, Any]:
    async with live.api.client(bearer) as client:
        reply = await client.post("/v1/ingest", json={"site": "lab", **body})
        assert reply.is_success, reply.text
        answer: dict[str, Any] = reply.json()
        return answer


async def test_batches_are_acknowledged_in_order_under_their_seq(live: LiveServer) -> None:
    async with live.socket("/v1/ingest/stream", "phone-7") as socket:
        for seq in range(20):
            await socket.send(json.dumps(batch(ble_record(6.0, 4.0, NOW_MS + seq), seq=seq)))
        acks = [await hear(socket) for _ in range(20)]
    assert [(ack["op"], ack["seq"], ack["accepted"]) for ack in acks] == [
        ("ack", seq, 1) for seq in range(20)
    ]
    assert acks[-1]["fix"]["x"] == pytest.approx(6.0, abs=1.5)


async def test_a_bad_frame_is_answered_and_the_socket_stays(live: LiveServer) -> None:
    async with live.socket("/v1/ingest/stream", "phone-7") as socket:
        for frame, seq, code, status in [
            ("{", None, "malformed_body", 400),
            ('{"x":' + "[" * 50_000, None, "malformed_body", 400),
            ({"seq": 3}, 3, "invalid_field", 422),
            (batch(seq=4, device={"id": "phone-8"}), 4, "device_forbidden", 403),
        ]:
            answer = await ask(socket, frame)
            assert (answer["op"], answer["seq"]) == ("error", seq)
            problem = answer["problem"]
            assert (problem["code"], problem["status"]) == (code, status)
        assert (await ask(socket, batch(seq=5)))["op"] == "ack"
        await ask(socket, batch(ble_record(1.0, 1.0, NOW_MS), seq=6))
        conflict = await ask(socket, batch(ble_record(2.0, 1.0, NOW_MS), seq=6))
        assert conflict["problem"]["code"] == "seq_conflict"


async def test_a_batch_that_cannot_be_stored_in_time_is_refused_and_the_log_says_why(
    database_url: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with (
        listening(database_url, ingest_wait_s=0.01) as live,
        live.socket("/v1/ingest/stream", "phone-7") as socket,
    ):
        with contextlib.closing(sqlite3.connect(database_url.removeprefix("sqlite:///"))) as other:
            other.execute("BEGIN IMMEDIATE")
            answer = await ask(socket, batch(seq=3))
    assert (answer["seq"], answer["problem"]["code"]) == (3, "unavailable")
    (line,) = (x for x in caplog.messages if "batch 3" in x)
    assert "no commit within 0.01 s" in line


async def test_frames_that_are_too_long_or_no_text_end_the_socket(live: LiveServer) -> None:
    async with live.socket("/v1/ingest/stream", "phone-7") as socket:
        await socket.send(" " * ((1 << 20) + 1))
        assert (await closing(socket))[0] == 1009
    async with live.socket("/v1/ingest/stream", "phone-7") as socket:
        await socket.send(b"{}")
        assert (await closing(socket))[0] == 4400


async def test_who_may_not_come_in_is_told_why(live: LiveServer) -> None:
    for path, bearer, code, reason in [
        ("/v1/ingest/stream", None, 4401, "token_missing"),
        ("/v1/ingest/stream", "expired", 4401, "token_expired"),
        ("/v1/ingest/stream", "viewer", 4403, "role_forbidden"),
        ("/v1/stream", None, 4401, "token_missing"),
        ("/v1/stream", "revoked", 4401, "token_invalid"),
    ]:
        async with live.socket(path, bearer) as socket:
            found, words = await closing(socket)
        assert (found, words.partition(":")[0]) == (code, reason), (path, bearer)


async def test_a_browser_comes_in_by_subprotocol_or_cookie_with_our_origin(
    live: LiveServer,
) -> None:
    secret = live.api.secrets["viewer"]
    offered = ["pharos.v1", f"bearer.{secret}"]
    async with live.socket("/v1/stream", None, subprotocols=offered) as socket:
        assert socket.subprotocol == "pharos.v1"
        assert await ask(socket, {"op": "ping"}) == {"op": "pong"}
    cookie = {"Cookie": f"pharos_token={secret}"}
    own = f"http://127.0.0.1:{live.port}"
    async with live.socket("/v1/stream", None, headers=cookie, origin=own) as socket:
        assert await ask(socket, {"op": "ping"}) == {"op": "pong"}
    for origin in ("http://evil.example", None):
        async with live.socket("/v1/stream", None, headers=cookie, origin=origin) as socket:
            code, words = await closing(socket)
        assert (code, words.partition(":")[0]) == (4403, "origin_forbidden")


async def test_a_subscriber_sees_what_is_and_what_comes(live: LiveServer) -> None:
    await post(live, batch(ble_record(6.0, 4.0, NOW_MS)))
    async with live.socket("/v1/stream", "viewer") as socket:
        wish = {"op": "subscribe", "id": "s1", "topic": "fixes", "filter": {"site_id": "lab"}}
        subscribed = await ask(socket, wish)
        assert (subscribed["op"], subscribed["id"]) == ("subscribed", "s1")
        assert [fix["device_id"] for fix in subscribed["snapshot"]] == ["phone-7"]
        answer = await post(live, batch(ble_record(7.0, 4.0, NOW_MS + 1000), seq=1))
        event = await hear(socket)
        assert (event["op"], event["id"]) == ("event", "s1")
        assert event["data"] == [answer["fix"]]
        await socket.send(json.dumps({"op": "unsubscribe", "id": "s1"}))
        await post(live, batch(ble_record(8.0, 4.0, NOW_MS + 2000), seq=2))
        assert await ask(socket, {"op": "ping"}) == {"op": "pong"}


async def test_the_absence_of_a_fix_is_streamed_with_its_reason(live: LiveServer) -> None:
    async with live.socket("/v1/stream") as socket:
        await ask(socket, {"op": "subscribe", "id": "s1", "topic": "fixes"})
        stranger = {"k": "ble", "t_ms": NOW_MS, "beacons": [{"mac": "c20000000001", "rssi": -60}]}
        await post(live, batch(stranger))
        (report,) = (await hear(socket))["data"]
    assert report["device_id"] == "phone-7"
    assert "x" not in report
    assert report["no_fix"]["reason"]


async def test_filters_by_device_and_floor(live: LiveServer) -> None:
    scan = ble_record(6.0, 4.0, NOW_MS)
    for name in ("phone-7", "phone-8"):
        await post(live, batch(scan, device={"id": name}))
    async with live.socket("/v1/stream") as socket:
        for wanted, seen in [
            ({"device": ["phone-8"]}, ["phone-8"]),
            ({"floor_id": "lab-0"}, ["phone-7", "phone-8"]),
            ({"floor_id": "roof"}, []),
            ({"site_id": "annex"}, []),
        ]:
            wish = {"op": "subscribe", "id": "s", "topic": "fixes", "filter": wanted}
            snapshot = (await ask(socket, wish))["snapshot"]
            assert sorted(fix["device_id"] for fix in snapshot) == seen, wanted


async def test_new_devices_are_told(live: LiveServer) -> None:
    async with live.socket("/v1/stream") as socket:
        await ask(socket, {"op": "subscribe", "id": "d", "topic": "devices"})
        await post(live, batch())
        event = await hear(socket)
    assert event["data"] == [{"event": "enrolled", "device_id": "phone-7", "site_id": "lab"}]
    assert event["eid"]


async def test_scopes_hold_in_the_stream(live: LiveServer) -> None:
    await post(live, batch(ble_record(6.0, 4.0, NOW_MS)))
    wish = {"op": "subscribe", "id": "s", "topic": "fixes"}
    async with live.socket("/v1/stream", "annex-viewer") as socket:
        assert (await ask(socket, wish))["snapshot"] == []
        other = await ask(socket, {**wish, "filter": {"site_id": "lab"}})
        assert (other["op"], other["id"], other["code"]) == ("error", "s", "site_forbidden")
    async with live.socket("/v1/stream", "phone-7") as socket:
        assert [f["device_id"] for f in (await ask(socket, wish))["snapshot"]] == ["phone-7"]
        other = await ask(socket, {**wish, "filter": {"device": ["phone-8"]}})
        assert other["code"] == "device_forbidden"
    async with live.socket("/v1/stream", "fleet") as socket:
        assert (await ask(socket, wish))["code"] == "device_forbidden"


async def test_frames_that_cannot_be_followed(live: LiveServer) -> None:
    async with live.socket("/v1/stream") as socket:
        for frame, code in [
            ("nonsense", "malformed_body"),
            ("{}", "invalid_field"),
            ({"op": "dance"}, "invalid_field"),
            ({"op": "subscribe", "id": "s"}, "invalid_field"),
            ({"op": "subscribe", "id": "s", "topic": "weather"}, "unknown_topic"),
            ({"op": "subscribe", "id": "s", "topic": "alerts"}, "unknown_topic"),
            ({"op": "unsubscribe", "id": "s"}, "unknown_subscription"),
            ({"op": "subscribe", "id": "", "topic": "fixes"}, "invalid_field"),
        ]:
            answer = await ask(socket, frame)
            assert (answer["op"], answer["code"]) == ("error", code), frame
        assert await ask(socket, {"op": "ping"}) == {"op": "pong"}


async def test_a_socket_has_a_bounded_number_of_subscriptions(live: LiveServer) -> None:
    async with live.socket("/v1/stream") as socket:
        answers = [
            await ask(socket, {"op": "subscribe", "id": f"s{i}", "topic": "devices"})
            for i in range(17)
        ]
    assert [answer["op"] for answer in answers] == ["subscribed"] * 16 + ["error"]
    assert answers[-1]["code"] == "too_many_subscriptions"


async def test_a_revoked_token_sees_and_posts_nothing_more(live: LiveServer) -> None:
    async with live.api.client() as client:
        made = await client.post("/v1/tokens", json={"name": "temporary", "role": "surveyor"})
        live.api.secrets["temporary"] = made.json()["token"]
        token_id = made.json()["token_id"]
        async with (
            live.socket("/v1/stream", "temporary") as viewer,
            live.socket("/v1/ingest/stream", "temporary") as poster,
        ):
            await ask(viewer, {"op": "subscribe", "id": "s", "topic": "fixes"})
            assert (await ask(poster, batch(site="lab")))["op"] == "ack"
            assert (await client.delete(f"/v1/tokens/{token_id}")).is_success
            await post(live, batch(ble_record(6.0, 4.0, NOW_MS), seq=1))
            assert (await closing(viewer))[0] == 4401
            await poster.send(json.dumps(batch(seq=2)))
            assert (await closing(poster))[0] == 4401


async def test_what_a_look_at_growth_has_shown_is_streamed_to_admins_alone(
    live: LiveServer,
) -> None:
    subscribe = {"op": "subscribe", "id": "j", "topic": "jobs"}
    results = {}
    async with (
        live.socket("/v1/stream", "admin") as admin,
        live.socket("/v1/stream", "viewer") as viewer,
    ):
        for socket in (admin, viewer):
            assert (await ask(socket, subscribe))["op"] == "subscribed"
        async with live.api.client() as client:
            assert (await client.post("/v1/sites/lab/growth")).status_code == 202
        for name, socket in (("admin", admin), ("viewer", viewer)):
            jobs = []
            while not jobs or jobs[-1]["ended"] is None:
                jobs += (await hear(socket))["data"]
            results[name] = jobs[-1]["result"]
    nothing = {"sessions": 0, "fingerprints": 0, "places": [], "effect": None}
    assert results == {"admin": nothing, "viewer": None}
