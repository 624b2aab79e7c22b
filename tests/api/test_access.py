"""Tokens and the browser's login over the real application."""

import asyncio
import sqlite3
from contextlib import closing

import pytest
from api_server import NOW_S, ApiServer, batch, serving

from app.services.tokens import hash_token, new_token

pytestmark = pytest.mark.anyio

OWN = {"Origin": "http://pharos.test"}
STRANGER = {"Origin": "http://evil.example"}


def test_secrets_are_long_random_and_stored_as_their_hash() -> None:
    first, second = new_token(), new_token()
    assert first != second
    assert len(first) >= len("pharos_") + 43
    assert len(hash_token(first)) == 32


async def test_a_browser_logs_in_with_its_token_and_out(server: ApiServer) -> None:
    async with server.client(None) as browser:
        wrong = await browser.post("/v1/login", json={"token": "pharos_wrong"})
        assert (wrong.status_code, wrong.json()["code"]) == (401, "token_invalid")
        entered = await browser.post("/v1/login", json={"token": server.secrets["viewer"]})
        assert entered.json() == {"role": "viewer", "site_id": None, "device_id": None}
        cookie = entered.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert (await browser.get("/v1/login")).json()["role"] == "viewer"
        assert (await browser.delete("/v1/login")).status_code == 204
        assert (await browser.get("/v1/login")).status_code == 401


async def test_the_cookie_is_sent_over_https_only_where_there_is_https(database_url: str) -> None:
    async with serving(database_url, cookie_secure=True) as server, server.client(None) as browser:
        entered = await browser.post("/v1/login", json={"token": server.secrets["viewer"]})
    assert "secure" in entered.headers["set-cookie"].lower()


async def test_pages_of_strangers_cannot_use_the_cookie(server: ApiServer) -> None:
    async with server.client(None) as browser:
        await browser.post("/v1/login", json={"token": server.secrets["admin"]})
        refused = await browser.post("/v1/ingest", json=batch(site="lab"), headers=STRANGER)
        assert (refused.status_code, refused.json()["code"]) == (403, "origin_forbidden")
        assert (await browser.post("/v1/ingest", json=batch(site="lab"), headers=OWN)).is_success


async def test_pages_of_the_cors_setting_may_call(database_url: str) -> None:
    origin = "https://map.example"
    async with serving(database_url, cors_origins=(origin,)) as server, server.client() as client:
        allowed = await client.get("/v1/time", headers={"Origin": origin})
        other = await client.get("/v1/time", headers=STRANGER)
    assert allowed.headers["access-control-allow-origin"] == origin
    assert "access-control-allow-origin" not in other.headers


async def test_a_token_ends_when_it_expires(server: ApiServer) -> None:
    async with server.client() as admin:
        wish = {"name": "guest", "role": "viewer", "expires": "2026-11-22T02:30:01Z"}
        server.secrets["guest"] = (await admin.post("/v1/tokens", json=wish)).json()["token"]
    async with server.client("guest") as guest:
        assert (await guest.get("/v1/time")).is_success
        server.clock.time_s = NOW_S + 599.0
        assert (await guest.get("/v1/time")).is_success
        server.clock.time_s = NOW_S + 600.0
        assert (await guest.get("/v1/time")).json()["code"] == "token_expired"


async def test_a_revoked_token_ends_at_once(server: ApiServer) -> None:
    async with server.client() as admin:
        made = (await admin.post("/v1/tokens", json={"name": "n", "role": "viewer"})).json()
        server.secrets["short"] = made["token"]
        async with server.client("short") as short:
            assert (await short.get("/v1/time")).is_success
            await admin.delete(f"/v1/tokens/{made['token_id']}")
            assert (await short.get("/v1/time")).json()["code"] == "token_invalid"


async def test_every_reply_carries_the_request_id(server: ApiServer) -> None:
    async with server.client() as client:
        own = await client.get("/v1/time", headers={"X-Request-ID": "walk-7.1"})
        odd = await client.get("/v1/time", headers={"X-Request-ID": "a b\x07"})
    assert own.headers["x-request-id"] == "walk-7.1"
    assert len(odd.headers["x-request-id"]) == 32


async def test_readiness_names_what_answers(server: ApiServer) -> None:
    async with server.client(None) as client:
        assert (await client.get("/healthz")).text == "ok"
        ready = await client.get("/readyz")
        assert (ready.status_code, ready.json()["writer"]) == (200, "ok")


async def test_a_database_that_takes_no_writes_is_told_as_503(
    database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.storage.engines.BUSY_TIMEOUT_MS", 100)
    async with serving(database_url) as server, server.client("phone-7") as client:
        assert (await client.post("/v1/ingest", json=batch())).is_success
        with closing(sqlite3.connect(database_url.removeprefix("sqlite:///"))) as other:
            other.execute("BEGIN IMMEDIATE")
            ready, refused = await asyncio.gather(
                client.get("/readyz"), client.post("/v1/ingest", json=batch(seq=1))
            )
        assert ready.status_code == 503
        assert ready.json() == {"ready": False, "database": "ok", "writer": "failed"}
        assert (refused.status_code, refused.json()["code"]) == (503, "unavailable")
        assert int(refused.headers["retry-after"]) > 0
        assert (await client.post("/v1/ingest", json=batch(seq=1))).is_success


async def test_how_long_a_write_waits_is_set_and_the_log_says_that_it_was_too_long(
    database_url: str, caplog: pytest.LogCaptureFixture
) -> None:
    waits = {"ingest_wait_s": 0.01, "edit_wait_s": 0.02}
    async with serving(database_url, **waits) as server, server.client() as client:
        with closing(sqlite3.connect(database_url.removeprefix("sqlite:///"))) as other:
            other.execute("BEGIN IMMEDIATE")
            posted = await client.post("/v1/ingest", json=batch(site="lab"))
            edited = await client.post("/v1/sites", json={"site_id": "shed", "name": "Shed"})
    assert [reply.json()["code"] for reply in (posted, edited)] == ["unavailable"] * 2
    for reply, wait_s in ((posted, 0.01), (edited, 0.02)):
        (line,) = (x for x in caplog.messages if reply.headers["x-request-id"] in x)
        assert f"no commit within {wait_s} s" in line


async def test_too_many_waiting_batches_are_told_as_429(
    server: ApiServer, database_url: str
) -> None:
    async with server.client("phone-7") as client:
        assert (await client.post("/v1/ingest", json=batch())).is_success
        with closing(sqlite3.connect(database_url.removeprefix("sqlite:///"))) as other:
            other.execute("BEGIN IMMEDIATE")
            posts = [
                asyncio.create_task(client.post("/v1/ingest", json=batch(seq=seq)))
                for seq in range(1, 70)
            ]
            done, waiting = await asyncio.wait(posts, return_when=asyncio.FIRST_COMPLETED)
        refused = done.pop().result()
        assert (refused.status_code, refused.json()["code"]) == (429, "too_many_requests")
        assert int(refused.headers["retry-after"]) >= 1
        answers = await asyncio.gather(*waiting)
    assert any(answer.is_success for answer in answers)
