"""``pharos import csv``: tables of beacons and fingerprints (docs/formats.md has the columns)."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from app.api.beacon_tables import BeaconChange, beacon_changes, checked_rows
from app.cli.errors import CommandError
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.formats.beacons_csv import BeaconTableError, read_beacons_csv
from app.formats.fingerprints_csv import FingerprintTableError, read_fingerprints_csv
from app.services.beacons import import_beacons as store_beacons
from app.services.fingerprint_import import storing_fingerprints
from app.storage.radio_maps import RadioMapOrigin

TableFile = Annotated[Path, typer.Argument(metavar="FILE", help="CSV with a header line, UTF-8.")]
SiteOption = Annotated[str, typer.Option(metavar="ID", help="Site that the table belongs to.")]


def import_beacons(
    file: TableFile,
    site: SiteOption,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Tell what would change, and store nothing.")
    ] = False,
    database: DatabaseOption = None,
) -> None:
    """Add and change beacons by their ids; good rows are taken, refused ones are listed."""
    console = Console(stderr=True)
    try:
        rows = list(read_beacons_csv(_text(file)))
    except BeaconTableError as error:
        msg = f"{file}: {error}"
        raise CommandError(msg) from error
    taken, lines, refused = checked_rows(site, rows)
    with local_database(database) as store:
        plan = asyncio.run(store_beacons(store, site, taken, dry_run=dry_run))
    reasons = {row.line: row.detail for row in refused}
    reasons |= {lines[row.index]: row.detail for row in plan.refused}
    for line, reason in sorted(reasons.items()):
        console.print(f"line {line} is refused: {reason}", style="yellow", markup=False)
    if dry_run:
        for change in beacon_changes(plan):
            console.print(_told(change), markup=False)
    would = "would be " if dry_run else ""
    console.print(
        f"{len(plan.created)} {would}added, {len(plan.updated)} {would}changed, "
        f"{plan.unchanged} as they were"
    )
    if reasons:
        msg = f"{len(reasons)} of {len(rows)} rows were refused"
        raise CommandError(msg)


def _told(change: BeaconChange) -> str:
    if change.added:
        return f"{change.beacon_id} is new"
    fields = (f"{name} {was} to {now}" for name, (was, now) in change.change.items())
    return f"{change.beacon_id}: {', '.join(fields)}"


def import_fingerprints(file: TableFile, site: SiteOption, database: DatabaseOption = None) -> None:
    """Make a radio map of fingerprints and activate it; the one before stays stored."""
    try:
        points = read_fingerprints_csv(_text(file))
    except FingerprintTableError as error:
        msg = f"{file}: {error}"
        raise CommandError(msg) from error
    origin = RadioMapOrigin(file.name, CLOCK.now_s(), {"format": "csv", "file": file.name})
    with local_database(database) as store:
        stored = store.write_now(storing_fingerprints(site, points, origin))
    Console(stderr=True).print(
        f"Radio map {stored.version}: {stored.fingerprints} fingerprints, "
        f"{stored.transmitters} transmitters"
    )


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{file} cannot be read: {error}"
        raise CommandError(msg) from error
