"""``pharos import``: what can be brought in, one file per format."""

import typer

from app.cli import import_csv, import_ms2020

importing = typer.Typer(no_args_is_help=True, help="Bring in sites, beacons and fingerprints.")
tables = typer.Typer(
    no_args_is_help=True, help="Bring in a table; docs/formats.md has its columns."
)

importing.command("ms2020")(import_ms2020.import_ms2020)
importing.add_typer(tables, name="csv")
tables.command("beacons")(import_csv.import_beacons)
tables.command("fingerprints")(import_csv.import_fingerprints)
