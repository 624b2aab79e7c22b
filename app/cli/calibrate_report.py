"""What ``pharos calibrate`` shows of a calibration."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.files import write_file
from app.core.geometry import ellipse95
from app.services.calibration_drafts import PLACES
from app.storage.calibrations import StoredCalibration

STDOUT = Path("-")
_ID_WIDTH = 16
"""An address as an id, ``mac-02005e005301``, stays in one piece on a terminal of 80 columns."""


def print_draft(draft: StoredCalibration, json_file: Path | None) -> None:
    """Show a stored calibration, and tell its id."""
    print_report(draft.kind, draft.report, json_file)
    if json_file == STDOUT:
        return
    draft_id = draft.calibration_id
    state = f"A draft, nothing is changed yet: pharos calibrate apply {draft_id}, or discard"
    Console(stderr=True).print(state if draft.applied_s is None else "Applied.", markup=False)
    typer.echo(draft_id)


def print_report(kind: str, report: Mapping[str, Any], json_file: Path | None) -> None:
    """Print a report as tables, and write it as JSON if asked; to ``-`` the JSON alone."""
    # Values of a report that was just made become what a stored one holds.
    document = msgspec.to_builtins(dict(report))
    text = msgspec.json.format(msgspec.json.encode(document)) + b"\n"
    if json_file == STDOUT:
        typer.echo(text.decode(), nl=False)
        return
    if json_file is not None:
        write_file(json_file, text)
    if kind == PLACES:
        Console().print(_places(document))
    else:
        _print_levels(document)


def _print_levels(report: Mapping[str, Any]) -> None:
    console = Console()
    table = Table(title=f"{len(report['beacons'])} beacons")
    table.add_column("beacon", no_wrap=True)
    for heading in ("levels", "dBm at d*", "exponent", "residual dB"):
        table.add_column(heading, justify="right")
    table.add_column("warnings", overflow="fold")
    for beacon in report["beacons"]:
        after = beacon["after"]
        table.add_row(
            escape(beacon["beacon_id"]),
            str(beacon["levels"]),
            f"{after['ref_level_dbm']:.1f}",
            f"{after['path_loss_exponent']:.2f}",
            _number(beacon["after_residual_db"], 1),
            " ".join(beacon["warnings"]),
        )
    console.print(table)
    for phone in report["phones"] if len(report["phones"]) > 1 else ():
        console.print(f"{escape(phone['device_id'])} hears {phone['offset_db']:+.1f} dB")
    console.print(
        f"Mean error at {report.get('left_out', 'places')} left out: "
        f"{_told(report['before'])} before, {_told(report['after'])} after"
    )


def _places(report: Mapping[str, Any]) -> Table:
    table = Table(
        title=f"{len(report['beacons'])} beacons",
        caption="Half axes of the ellipse that holds the beacon in 95 of 100 cases, and the "
        "direction of the long one from the plan's +x; dBm at 1 m; n is the path-loss exponent.",
    )
    table.add_column("beacon", overflow="fold", min_width=_ID_WIDTH)
    for heading in ("levels", "x", "y", "95 % m", "along", "dBm", "n"):
        table.add_column(heading, justify="right", overflow="fold")
    for beacon in report["beacons"]:
        model = beacon["model"] or {}
        # Below the id: as a column of their own they would take the numbers' room.
        table.add_row(
            escape("\n".join([beacon["beacon_id"], *beacon["warnings"]])),
            str(beacon["levels"]),
            _number(beacon["x_m"], 1),
            _number(beacon["y_m"], 1),
            *_axes(beacon["covariance_m2"]),
            _number(model.get("ref_level_dbm"), 1),
            _number(model.get("path_loss_exponent"), 2),
        )
    return table


def _axes(covariance_m2: tuple[float, float, float] | None) -> tuple[str, str]:
    if covariance_m2 is None:
        return "", ""
    xx, xy, yy = covariance_m2
    ellipse = ellipse95((xx, xy, yy))
    axes = f"{ellipse.major_m:.1f} x {ellipse.minor_m:.1f}"
    return axes, f"{math.degrees(ellipse.direction_rad):.0f}°"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _told(error: Mapping[str, Any]) -> str:
    return "unknown" if error["mean_error_m"] is None else f"{error['mean_error_m']:.2f} m"
