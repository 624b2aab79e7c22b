"""``pharos demo``: the simulated warehouse, a server, and phones that walk through it."""

import asyncio
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
import uvicorn
from rich.console import Console
from rich.status import Status
from sqlalchemy import Connection

from app.cli.demo_phones import DEVICE_PREFIX, Fleet, people_of
from app.cli.errors import CommandError
from app.cli.local import CLOCK, settings_with
from app.config import Settings
from app.core.simulate import Warehouse, warehouse
from app.main import create_app, uvicorn_options
from app.services.access import Role
from app.services.demo import enrol_people, install_warehouse
from app.services.tokens import hash_token, new_token
from app.storage.database import Database
from app.storage.migrate import upgrade
from app.storage.tokens import StoredToken, create_token

SEED = 1
USUAL_PORT = 8000
START_LIMIT_S = 120.0
STOP_LIMIT_S = 2.0


@dataclass(frozen=True, slots=True)
class DemoTokens:
    """Secrets of one demo: the dashboard's and the phones'."""

    dashboard: str
    phones: str


def demo(
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Port to listen on; default: 8000, or any free one."),
    ] = None,
    phones: Annotated[int, typer.Option(min=1, max=500, help="How many phones walk.")] = 30,
    folder: Annotated[
        Path | None, typer.Option(help="Keep the database here; default: a temporary folder.")
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.1, max=20.0, help="How much faster than real time they walk.")
    ] = 1.0,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Stop by itself after this long.")
    ] = None,
) -> None:
    """Show people moving in a simulated warehouse; Ctrl-C stops it."""
    console = Console()
    try:
        with (
            _kill_like_ctrl_c(),
            _database_folder(folder) as where,
            _listening_socket(port) as listening,
            console.status("Laying out the warehouse ...") as status,
        ):
            settings = settings_with(
                database_url=f"sqlite:///{where / 'pharos.db'}", port=listening.getsockname()[1]
            )
            world = warehouse(SEED)
            role, people = role_of_phones(speed), people_of(phones)
            tokens = asyncio.run(_fill(settings.database_url, world, role, people))
            status.update("Starting the server (the first time compiles the engine) ...")
            with _serving(settings, listening) as url:
                fleet = Fleet(url, tokens.phones, world, CLOCK, phones, speed)
                console.print(f"Database  {where}", soft_wrap=True, highlight=False)
                link = f"{url}/#token={tokens.dashboard}"
                console.print(f"Dashboard {link}", soft_wrap=True, highlight=False)
                status.update(f"{phones} phones set out; Ctrl-C stops")
                asyncio.run(_walk(fleet, seconds, status))
    except KeyboardInterrupt:
        console.print("Stopped.")
    else:
        console.print(f"Done: {fleet.tally.batches} batches, {fleet.tally.fixes} fixes.")


def role_of_phones(speed: float) -> Role:
    """Return the role that phones need: only surveyors may post at another pace than life."""
    return Role.DEVICE if speed == 1.0 else Role.SURVEYOR


@contextmanager
def _kill_like_ctrl_c() -> Iterator[None]:
    """Let a plain ``kill`` stop the demo as cleanly as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _database_folder(folder: Path | None) -> Iterator[Path]:
    """Yield a folder without a database: the given one, or a temporary one that goes in the end."""
    if folder is None:
        with tempfile.TemporaryDirectory(prefix="pharos-demo-") as temporary:
            yield Path(temporary)
        return
    if (folder / "pharos.db").exists():
        msg = f"{folder} has a database already; the demo starts with a fresh one"
        raise CommandError(msg, 2)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{folder} cannot be made: {error.strerror}"
        raise CommandError(msg) from error
    yield folder.resolve()


@contextmanager
def _listening_socket(port: int | None) -> Iterator[socket.socket]:
    """Yield a bound socket: on the port asked for, else on the usual one, else on any."""
    wanted = (USUAL_PORT, 0) if port is None else (port,)
    for candidate in wanted:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind(("127.0.0.1", candidate))
        except OSError:
            listening.close()
            continue
        with listening:
            yield listening
        return
    msg = f"port {port} is taken"
    raise CommandError(msg)


async def _fill(
    database_url: str, world: Warehouse, role: Role, people: dict[str, str]
) -> DemoTokens:
    """Put the warehouse, its people and two tokens into a fresh database."""
    upgrade(database_url)
    database = Database(database_url)
    tokens = DemoTokens(new_token(), new_token())
    dashboard = _stored(tokens.dashboard, "Demo dashboard", Role.ADMIN)
    phones = _stored(tokens.phones, "Demo phones", role)
    if role is Role.DEVICE:
        phones = replace(phones, device_prefix=DEVICE_PREFIX)

    def store_tokens(connection: Connection) -> None:
        create_token(connection, dashboard)
        create_token(connection, phones)

    try:
        await install_warehouse(database, world, CLOCK.now_s())
        await enrol_people(database, world.site.site_id, people, CLOCK.now_s())
        await database.write(store_tokens)
    finally:
        await database.close()
    return tokens


def _stored(secret: str, name: str, role: Role) -> StoredToken:
    token_hash = hash_token(secret)
    token_id = f"tok-{token_hash.hex()[:12]}"
    return StoredToken(token_id, name, token_hash, role, CLOCK.now_s())


@contextmanager
def _serving(settings: Settings, listening: socket.socket) -> Iterator[str]:
    """Run the real server in a thread of its own, and stop it in the end."""
    # Whoever watches is cut off after a second: Ctrl-C is to be over at once.
    options = uvicorn_options(settings) | {"log_level": "warning", "timeout_graceful_shutdown": 1}
    config = uvicorn.Config(create_app(settings), **options)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([listening],), name="server", daemon=True)
    thread.start()
    deadline_s = time.monotonic() + START_LIMIT_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > deadline_s:
            msg = "the server did not start; its log above says why"
            raise CommandError(msg)
        time.sleep(0.02)
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(timeout=5.0)


async def _walk(fleet: Fleet, seconds: float | None, status: Status) -> None:
    """Let the phones walk, telling how they fare, until the time is up or they are refused."""

    async def tell() -> None:
        while True:
            await asyncio.sleep(1.0)
            status.update(f"{fleet.phones} phones, {fleet.tally.fixes} fixes; Ctrl-C stops")

    loop, interrupted = asyncio.get_running_loop(), asyncio.Event()
    loop.add_signal_handler(signal.SIGINT, interrupted.set)
    walking = asyncio.create_task(fleet.run())
    watching = asyncio.create_task(interrupted.wait())
    telling = asyncio.create_task(tell())
    await asyncio.wait({walking, watching}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
    loop.remove_signal_handler(signal.SIGINT)
    fleet.stopping = True
    over = walking.done()
    for task in (walking, watching, telling):
        task.cancel()
    await asyncio.wait({walking}, timeout=STOP_LIMIT_S)
    if over:
        walking.result()
    if interrupted.is_set():
        raise KeyboardInterrupt
