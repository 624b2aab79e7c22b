"""``pharos calibrate``: parameters fitted on recordings of one's own."""

import typer

from app.cli.calibrate_fusion import calibrate_fusion

calibrating = typer.Typer(
    no_args_is_help=True, help="Fit parameters on recordings with known positions."
)


@calibrating.callback()
def _options() -> None:
    # Typer makes a group, and not one command, of an application that has this.
    pass


calibrating.command("fusion")(calibrate_fusion)
