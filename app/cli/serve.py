"""``pharos serve``: the server."""

import errno
import os
import socket
from typing import Annotated

import typer

from app.cli.errors import CommandError
from app.cli.local import DatabaseOption, local_database, settings_with
from app.config import Settings
from app.main import run


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
    # What usually goes wrong is told here in one line, not in the log of a server that gives up.
    _check_address(settings)
    with local_database(settings.database_url):
        pass
    run(settings)


def _check_address(settings: Settings) -> None:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((settings.host, settings.port))
        except OSError as error:
            taken = error.errno == errno.EADDRINUSE
            why = "is in use" if taken else f"cannot be used: {os.strerror(error.errno or 0)}"
            msg = f"address {settings.host}:{settings.port} {why}"
            raise CommandError(msg) from error
