"""``pharos calibrate``: parameters fitted on recordings of one's own."""

import typer

from app.cli.calibrate_beacons import calibrate_beacons
from app.cli.calibrate_drafts import apply, discard, list_calibrations, show
from app.cli.calibrate_fusion import calibrate_fusion
from app.cli.calibrate_places import calibrate_places

calibrating = typer.Typer(
    no_args_is_help=True, help="Fit parameters on recordings with known positions."
)

calibrating.command("beacons")(calibrate_beacons)
calibrating.command("places")(calibrate_places)
calibrating.command("list")(list_calibrations)
calibrating.command("show")(show)
calibrating.command("apply")(apply)
calibrating.command("discard")(discard)
calibrating.command("fusion")(calibrate_fusion)
