"""The application behind a real uvicorn on loopback, in the test's own event loop."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import uvicorn
from api_server import ApiServer, MovableClock, fill
from server_process import PATIENCE
from websockets.asyncio.client import ClientConnection, connect

from app.config import Settings
from app.main import create_app, uvicorn_options


@dataclass
class LiveServer:
    """A listening server; ``api`` speaks to the same application in process."""

    api: ApiServer
    port: int

    def socket(self, path: str, bearer: str | None = "admin", **options: object) -> connect:
        """Return a WebSocket of a token's bearer, to be entered with ``async with``."""
        headers = dict(options.pop("headers", {}))  # type: ignore[call-overload]
        if bearer is not None:
            headers["Authorization"] = f"Bearer {self.api.secrets[bearer]}"
        url = f"ws://127.0.0.1:{self.port}{path}"
        return connect(url, additional_headers=headers, proxy=None, **options)  # type: ignore[arg-type]


@asynccontextmanager
async def listening(database_url: str, **settings: object) -> AsyncIterator[LiveServer]:
    """Serve a migrated database on a free port."""
    clock = MovableClock()
    secrets = fill(database_url)
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    chosen = {"migrate": False, "port": port, "log_level": "warning", **PATIENCE, **settings}
    used = Settings(database_url=database_url, **chosen)
    app = create_app(used, clock)
    server = uvicorn.Server(uvicorn.Config(app, **uvicorn_options(used)))
    serving = asyncio.create_task(server.serve([listener]))
    try:
        while not server.started:
            assert not serving.done()
            await asyncio.sleep(0.01)
        yield LiveServer(ApiServer(app, clock, secrets), port)
    finally:
        server.should_exit = True
        await serving
        listener.close()


__all__ = ["ClientConnection", "LiveServer", "listening"]
