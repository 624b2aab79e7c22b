"""The database of this machine's settings, for commands that work on it without a server."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from pydantic import ValidationError
from pydantic_settings import SettingsError
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from app.cli.errors import CommandError
from app.config import Settings
from app.main import SystemClock
from app.storage.database import Database
from app.storage.migrate import upgrade

CLOCK = SystemClock()

DatabaseOption = Annotated[
    str | None,
    typer.Option(
        "--database",
        metavar="URL",
        help="SQLAlchemy URL, instead of PHAROS_DATABASE_URL.",
        show_default=False,
    ),
]

SiteFilter = Annotated[
    str | None, typer.Option("--site", metavar="ID", help="Only those of this site.")
]

EVERY_ROW = 1_000_000
"""Rows that a list shows at most: a terminal has no pages, and no site has so many of anything."""


def settings_with(
    *, host: str | None = None, port: int | None = None, database_url: str | None = None
) -> Settings:
    """Return the settings of the environment, with the options that were given in their place."""
    given = {"host": host, "port": port, "database_url": database_url}
    try:
        return Settings().model_copy(update={k: v for k, v in given.items() if v is not None})
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors())
        msg = f"settings: {wrong}"
        raise CommandError(msg, 2) from error
    except SettingsError as error:
        msg = f"settings: {error}"
        raise CommandError(msg, 2) from error


@contextmanager
def local_database(url: str | None) -> Iterator[Database]:
    """Open the database, brought up to date if the settings say so."""
    settings = settings_with(database_url=url)
    try:
        if settings.migrate:
            upgrade(settings.database_url)
        database = Database(settings.database_url)
    except (SQLAlchemyError, ArgumentError, ValueError) as error:
        raise database_error(settings.database_url, error) from error
    try:
        yield database
    except SQLAlchemyError as error:
        raise database_error(settings.database_url, error) from error
    finally:
        database.close_now()


def database_error(url: str, error: Exception) -> CommandError:
    """Return what to say of a database that cannot be used; its password is not repeated."""
    where = url.rpartition("@")[2]
    first_line = str(getattr(error, "orig", None) or error).partition("\n")[0]
    return CommandError(f"the database {where} cannot be used: {first_line}")
