"""``pharos evaluate``: accuracy on public data sets, one command per data set."""

import typer

from app.cli.evaluate_ms2020 import evaluate_ms2020

evaluating = typer.Typer(no_args_is_help=True, help="Measure accuracy on public data sets.")
evaluating.command("ms2020")(evaluate_ms2020)


@evaluating.callback()
def _group() -> None:
    # Typer makes a group, and not one command, of an application that has this.
    pass
