"""A real server in a process of its own on a free port; it can be killed and started again."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx

from app.services.access import Role
from app.services.tokens import hash_token, new_token
from app.storage.database import Database
from app.storage.tokens import StoredToken, create_token

START_LIMIT_S = 60.0
STOP_LIMIT_S = 10.0
# On a crowded machine a thread may not run for seconds, whatever it waits for. Servers of tests
# outwait that; tests of the limits set them.
PATIENCE = {"ingest_wait_s": "60", "edit_wait_s": "60"}
COMMAND = (sys.executable, "-c", "from app.cli.main import main; main()", "serve")


class ServerProcess:
    """``pharos serve`` over one database, with an admin's token.

    The log of all its runs is kept in ``log_path`` and shown when it does not come up.
    """

    def __init__(self, database_url: str, log_path: Path, **settings: str) -> None:
        self.database_url = database_url
        self.log_path = log_path
        self.port = _free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self.token = _admin_token(database_url)
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Return the id of the process that serves now."""
        assert self._process is not None
        return self._process.pid

    @property
    def headers(self) -> dict[str, str]:
        """Return the headers of an admin's request."""
        return {"Authorization": f"Bearer {self.token}"}

    def client(self) -> httpx.Client:
        """Return a client that speaks as the admin."""
        return httpx.Client(base_url=self.url, headers=self.headers, timeout=30.0, trust_env=False)

    def start(self) -> None:
        """Start it and wait until it is ready."""
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PHAROS_")}
        environment |= {
            "PHAROS_DATABASE_URL": self.database_url,
            "PHAROS_PORT": str(self.port),
            **{
                f"PHAROS_{name.upper()}": value
                for name, value in {**PATIENCE, **self._settings}.items()
            },
        }
        with self.log_path.open("ab") as log:
            self._process = subprocess.Popen(
                COMMAND, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        deadline_s = time.monotonic() + START_LIMIT_S
        while not self._ready():
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                self.kill()
                message = f"the server did not come up:\n{self.log_path.read_text()[-4000:]}"
                raise AssertionError(message)
            time.sleep(0.05)

    def kill(self) -> None:
        """End it at once, as a crash or a power cut would (``kill -9``)."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def stop(self) -> None:
        """End it as an operator does (``kill``); it must go by itself."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(STOP_LIMIT_S)
            finally:
                self.kill()

    def _ready(self) -> bool:
        try:
            return httpx.get(f"{self.url}/readyz", timeout=5.0, trust_env=False).is_success
        except httpx.TransportError:
            return False


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _admin_token(database_url: str) -> str:
    secret = new_token()
    token = StoredToken("tok-test-admin", "test", hash_token(secret), Role.ADMIN, created_s=0.0)
    database = Database(database_url)
    try:
        database.write_now(lambda connection: create_token(connection, token))
    finally:
        database.close_now()
    return secret
