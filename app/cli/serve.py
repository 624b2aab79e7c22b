"""``pharos serve``: the server."""

import errno
import os
import socket
from typing import Annotated

import typer
import uvicorn

from app.cli.errors import CommandError
from app.cli.local import DatabaseOption, local_database, settings_with
from app.config import Settings
from app.main import create_app


def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on, instead of PHAROS_HOST.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port, instead of PHAROS_PORT.")
    ] = None,
    database: DatabaseOption = None,
) -> None:
    """Run the server; settings come from the environment (docs/running.md lists them)."""
    settings = settings_with(host=host, port=port, database_url=database)
    listening = _listening_socket(settings)
    # A database that cannot be used is told here in one line, not by a server that fails to start.
    with local_database(settings.database_url):
        pass
    server = uvicorn.Server(server_config(settings))
    server.run(sockets=[listening])
    if not server.started:
        msg = "the server did not start; its log above says why"
        raise CommandError(msg)


def server_config(settings: Settings) -> uvicorn.Config:
    """Return how the server is run: fast parsers, no socket compression, bounded frames."""
    return uvicorn.Config(
        create_app(settings),
        log_level=settings.log_level,
        access_log=settings.log_level == "debug",
        http="httptools",
        ws="websockets-sansio",
        # Deflate makes fan-out to many dashboards several times dearer, and some clients refuse it.
        ws_per_message_deflate=False,
        ws_max_size=settings.max_body_bytes,
        timeout_graceful_shutdown=5,
    )


def _listening_socket(settings: Settings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((settings.host, settings.port))
    except OSError as error:
        listening.close()
        taken = error.errno == errno.EADDRINUSE
        why = "is in use" if taken else f"cannot be listened on: {os.strerror(error.errno or 0)}"
        msg = f"{settings.host}:{settings.port} {why}"
        raise CommandError(msg) from error
    listening.set_inheritable(True)
    return listening
