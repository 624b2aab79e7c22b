"""How a server starts: schema, first token, and what it left behind last time."""

from pathlib import Path

import httpx
import pytest
from api_server import MovableClock, batch, ble_record, serving

from app.config import Settings
from app.main import OutdatedDatabaseError, create_app
from app.storage import migrate

pytestmark = pytest.mark.anyio


async def test_the_first_start_shows_one_admin_token_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sqlite:///{tmp_path / 'new.db'}"
    settings = Settings(database_url=url, public_url="https://pharos.example")
    app = create_app(settings, MovableClock())
    async with app.router.lifespan_context(app):
        token = capsys.readouterr().out.partition("/#token=")[2].strip()
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://t") as client:
            headers = {"Authorization": f"Bearer {token}"}
            assert (await client.get("/v1/login", headers=headers)).json()["role"] == "admin"
    again = create_app(settings, MovableClock())
    async with again.router.lifespan_context(again):
        assert capsys.readouterr().out == ""


async def test_an_outdated_database_is_refused_when_it_may_not_be_migrated(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'old.db'}"
    migrate.upgrade(url)
    migrate.downgrade(url, "base")
    app = create_app(Settings(database_url=url, migrate=False))
    with pytest.raises(OutdatedDatabaseError, match="pharos migrate"):
        async with app.router.lifespan_context(app):
            pass


async def test_a_session_goes_on_after_a_restart(database_url: str) -> None:
    body = batch(ble_record(6.0, 4.0, 1_795_314_000_500))
    async with serving(database_url) as server, server.client("phone-7") as client:
        first = (await client.post("/v1/ingest", json=body)).json()
    app = create_app(Settings(database_url=database_url), server.clock)
    async with app.router.lifespan_context(app):
        server.app = app
        async with server.client("phone-7") as client:
            again = (await client.post("/v1/ingest", json=body)).json()
    assert again["duplicate"] is True
    assert again["fix"] == first["fix"]
