"""The command line ``pharos``: one file per command, joined here."""

import sys

import typer
from rich.console import Console

from app.cli.errors import CommandError
from app.cli.lazy import lazy_group

cli = typer.Typer(
    name="pharos",
    help="Self-hosted, real-time indoor positioning server.",
    cls=lazy_group(
        {
            "serve": ("app.cli.serve:serve", "Run the server."),
            "demo": ("app.cli.demo:demo", "Show people moving in a simulated warehouse."),
            "replay": ("app.cli.replay:replay", "Post recorded walks like phones, and score them."),
            "evaluate": (
                "app.cli.evaluate:evaluating",
                "Measure accuracy on public data sets.",
            ),
            "plan": ("app.cli.plan:plan", "Predict the error of a layout of beacons."),
            "profiles": ("app.cli.profiles:profiles", "Show the profiles and their parameters."),
            "calibrate": (
                "app.cli.calibrate:calibrating",
                "Fit parameters on recordings with known positions.",
            ),
            "import": ("app.cli.imports:importing", "Bring in sites, beacons and fingerprints."),
            "survey": ("app.cli.survey:surveying", "Bring surveys to a server, and judge them."),
            "jobs": ("app.cli.jobs:jobs", "List long work: uploads, builds of radio maps."),
            "radio-map": (
                "app.cli.radio_map:radio_map_commands",
                "Build, compare, activate and carry radio maps.",
            ),
            "growth": ("app.cli.growth:growing", "Let a radio map grow from use."),
            "token": ("app.cli.token:tokens", "Make, list and revoke access tokens."),
            "migrate": ("app.cli.migrate:migrate", "Bring the database to this version's schema."),
        }
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@cli.callback()
def _options() -> None:
    # Typer makes a group, and not one command, of an application that has this.
    pass


def main() -> None:
    """Run the command line; expected failures end it with one line on stderr."""
    try:
        cli()
    except SystemExit:
        raise
    except CommandError as error:
        _fail(str(error), error.exit_code)
    except _expected_failures() as error:
        _fail(str(error), 1)


def _expected_failures() -> tuple[type[Exception], ...]:
    # Imported only when something has failed; help and a usual end come without them.
    from app.main import OutdatedDatabaseError  # noqa: PLC0415
    from app.services.errors import AppError  # noqa: PLC0415
    from app.storage.database import DatabaseUnavailableError  # noqa: PLC0415

    return AppError, DatabaseUnavailableError, OutdatedDatabaseError


def _fail(message: str, exit_code: int) -> None:
    Console(stderr=True, highlight=False, soft_wrap=True).print(
        f"[bold red]pharos:[/] {_escaped(message)}"
    )
    sys.exit(exit_code)


def _escaped(message: str) -> str:
    # Square brackets would be taken for markup.
    return " ".join(message.split()).replace("[", r"\[")
