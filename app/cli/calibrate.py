"""``pharos calibrate``: parameters fitted on recordings of one's own."""

import typer

from app.cli.calibrate_beacons import calibrate_beacons
from app.cli.calibrate_fusion import calibrate_fusion

calibrating = typer.Typer(
    no_args_is_help=True, help="Fit parameters on recordings with known positions."
)

calibrating.command("beacons")(calibrate_beacons)
calibrating.command("fusion")(calibrate_fusion)
