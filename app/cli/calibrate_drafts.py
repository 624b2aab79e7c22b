"""``pharos calibrate list``, ``show``, ``apply`` and ``discard``: what becomes of drafts.

A running server takes up what is applied here within seconds.
"""

import asyncio
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from app.cli.calibrate_report import print_draft
from app.cli.evaluate_output import JsonOption
from app.cli.local import CLOCK, EVERY_ROW, DatabaseOption, SiteFilter, local_database
from app.cli.tables import minute_of
from app.services import calibration_drafts as drafts
from app.services.errors import found
from app.storage import calibrations

CalibrationArgument = Annotated[
    str, typer.Argument(metavar="CALIBRATION", help="Id of a calibration.")
]


def list_calibrations(
    site: SiteFilter = None,
    database: DatabaseOption = None,
) -> None:
    """List calibrations of levels and of places, drafts and applied ones."""
    with local_database(database) as store:
        stored = store.read_now(
            lambda c: calibrations.list_calibrations(c, site_id=site, after=None, limit=EVERY_ROW)
        )
    table = Table()
    table.add_column("id", no_wrap=True)
    for heading in ("floor", "of", "beacons", "created", "state"):
        table.add_column(heading, overflow="fold")
    for one in sorted(stored, key=lambda one: one.created_s):
        created = minute_of(one.created_s)
        state = "draft" if one.applied_s is None else "applied"
        count = str(len(one.report["beacons"]))
        table.add_row(one.calibration_id, one.floor_id, one.kind, count, created, state)
    Console().print(table)


def show(
    calibration: CalibrationArgument,
    json_file: JsonOption = None,
    database: DatabaseOption = None,
) -> None:
    """Show a calibration again."""
    with local_database(database) as store:
        stored = store.read_now(lambda c: calibrations.get_calibration(c, calibration))
    print_draft(found(stored, "calibration", calibration), json_file)


def apply(calibration: CalibrationArgument, database: DatabaseOption = None) -> None:
    """Put a draft's values into the registry, all or none."""
    with local_database(database) as store:
        applied = asyncio.run(drafts.apply_calibration(store, calibration, None, CLOCK.now_s()))
    typer.echo(f"beacons changed: {len(applied.proposed)}")


def discard(calibration: CalibrationArgument, database: DatabaseOption = None) -> None:
    """Remove a draft, or the record of an applied one; the registry stays as it is."""
    with local_database(database) as store:
        asyncio.run(drafts.discard_calibration(store, calibration, None))
