"""The command line ``pharos``: one file per command, joined here."""

import sys

import typer
from rich.console import Console

from app.cli import demo, import_csv, import_ms2020, migrate, replay, serve, token
from app.cli.errors import CommandError
from app.main import OutdatedDatabaseError
from app.services.errors import AppError
from app.storage.database import DatabaseUnavailableError

cli = typer.Typer(
    name="pharos",
    help="Self-hosted, real-time indoor positioning server.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
importing = typer.Typer(no_args_is_help=True, help="Bring in sites, beacons and fingerprints.")
tables = typer.Typer(
    no_args_is_help=True, help="Bring in a table; docs/formats.md has its columns."
)

cli.command("serve")(serve.serve)
cli.command("demo")(demo.demo)
cli.command("migrate")(migrate.migrate)
cli.command("replay")(replay.replay)
cli.add_typer(token.tokens, name="token")
cli.add_typer(importing, name="import")
importing.command("ms2020")(import_ms2020.import_ms2020)
importing.add_typer(tables, name="csv")
tables.command("beacons")(import_csv.import_beacons)
tables.command("fingerprints")(import_csv.import_fingerprints)


def main() -> None:
    """Run the command line; expected failures end it with one line on stderr."""
    try:
        cli()
    except CommandError as error:
        _fail(str(error), error.exit_code)
    except (AppError, DatabaseUnavailableError, OutdatedDatabaseError) as error:
        _fail(str(error), 1)


def _fail(message: str, exit_code: int) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(
        f"[bold red]pharos:[/] {_escaped(message)}"
    )
    sys.exit(exit_code)


def _escaped(message: str) -> str:
    # Square brackets would be taken for markup.
    return " ".join(message.split()).replace("[", r"\[")
