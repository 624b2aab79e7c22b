"""``pharos radio-map``: versions of a site's radio map, on the database of this machine.

A running server takes up what is activated here within seconds.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.errors import CommandError
from app.cli.local import CLOCK, EVERY_ROW, DatabaseOption, SiteFilter, local_database
from app.cli.tables import minute_of
from app.core.fingerprint.comparison import Comparison
from app.services import radio_maps as service
from app.services.radio_map_building import BuildOptions, BuildReport, Placing, built_map
from app.services.radio_map_builds import (
    DEFAULT_NAME,
    BuildRequest,
    load_surveyed,
    storing_built,
    surveys_to_build,
)
from app.storage.radio_maps import StoredRadioMap, list_radio_maps

radio_map_commands = typer.Typer(
    no_args_is_help=True, help="Build, compare, activate and carry radio maps."
)

MapArgument = Annotated[str, typer.Argument(metavar="MAP", help="Id of a radio map.")]
SiteOption = Annotated[str, typer.Option("--site", metavar="ID", help="Id of the site.")]

_SHOWN = 10


@radio_map_commands.command("list")
def list_maps(
    site: SiteFilter = None,
    database: DatabaseOption = None,
) -> None:
    """List radio maps; the active one of each site has a star."""
    with local_database(database) as store:
        stored = store.read_now(lambda c: list_radio_maps(c, site_id=site, limit=EVERY_ROW))
    table = Table()
    # Other commands ask for the id: it is never cut off.
    table.add_column("id", no_wrap=True)
    for heading in ("site", "version", "name", "fingerprints", "transmitters", "created"):
        table.add_column(heading, overflow="fold")
    for one in sorted(stored, key=lambda one: (one.site_id, one.version)):
        version = f"{one.version} *" if one.active else str(one.version)
        counts = (str(one.fingerprints), str(one.transmitters))
        created = minute_of(one.created_s)
        table.add_row(one.radio_map_id, one.site_id, version, escape(one.name), *counts, created)
    Console().print(table)


@radio_map_commands.command("build")
def build(  # noqa: PLR0913 - one parameter per option
    site: SiteOption,
    survey: Annotated[
        list[str] | None,
        typer.Option(metavar="ID", help="A survey to build it of; default: all of the site."),
    ] = None,
    name: Annotated[str, typer.Option(metavar="NAME", help="For people.")] = DEFAULT_NAME,
    virtual: Annotated[
        bool, typer.Option(help="Fill walkable floor that the survey missed.")
    ] = True,
    cleaning: Annotated[
        bool, typer.Option(help="One cleaned fingerprint for each reference point.")
    ] = True,
    placing: Annotated[
        Placing, typer.Option(help="How scans of walks are placed between waypoints.")
    ] = Placing.SMOOTHED,
    database: DatabaseOption = None,
) -> None:
    """Build a radio map of surveys and print its id; it is not active until it is activated."""
    options = BuildOptions(virtual, cleaning, placing)
    asked = BuildRequest(site, tuple(survey or ()), name, options)
    console = Console(stderr=True)
    with local_database(database) as store:
        asked = store.read_now(lambda c: surveys_to_build(c, asked))
        surveyed, floors = store.read_now(lambda c: load_surveyed(c, asked))
        built = built_map(surveyed, floors, options)
        stored = store.write_now(storing_built(asked, built, CLOCK.now_s()))
    _print_report(console, built.report)
    console.print(
        f"Version {stored.version}: {stored.fingerprints} fingerprints, "
        f"{stored.transmitters} transmitters; pharos radio-map activate {stored.radio_map_id}"
    )
    typer.echo(stored.radio_map_id)


@radio_map_commands.command("activate")
def activate(radio_map: MapArgument, database: DatabaseOption = None) -> None:
    """Match with this radio map from now on."""
    with local_database(database) as store:
        _told_active(store.write_now(lambda c: service.activate(c, radio_map)))


@radio_map_commands.command("rollback")
def roll_back(site: SiteOption, database: DatabaseOption = None) -> None:
    """Match with the radio map again that was active before."""
    with local_database(database) as store:
        _told_active(store.write_now(lambda c: service.roll_back(c, site)))


@radio_map_commands.command("delete")
def delete(radio_map: MapArgument, database: DatabaseOption = None) -> None:
    """Remove a radio map, which must not be the active one."""
    with local_database(database) as store:
        store.write_now(lambda c: service.remove(c, radio_map))


@radio_map_commands.command("compare")
def compare(before: MapArgument, after: MapArgument, database: DatabaseOption = None) -> None:
    """Tell what changed from one radio map to another."""
    with local_database(database) as store:
        pair = store.read_now(lambda c: service.load_pair(c, before, after))
    _print_comparison(Console(), service.compared(*pair))


@radio_map_commands.command("export")
def export(
    radio_map: MapArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A ZIP archive to write.")],
    database: DatabaseOption = None,
) -> None:
    """Write a radio map to one file; docs/formats.md says what is in it."""
    with local_database(database) as store:
        raw = store.read_now(lambda c: service.exported(c, radio_map))
    try:
        file.write_bytes(raw)
    except OSError as error:
        raise CommandError(str(error)) from error


@radio_map_commands.command("import")
def import_map(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="As exported.")],
    site: SiteOption,
    database: DatabaseOption = None,
) -> None:
    """Take a radio map from a file and print its id; it is not active until it is activated."""
    try:
        raw = file.read_bytes()
    except OSError as error:
        raise CommandError(str(error)) from error
    content = service.read_file(raw)
    with local_database(database) as store:
        stored = store.write_now(lambda c: service.imported(c, site, content, CLOCK.now_s()))
    typer.echo(stored.radio_map_id)


def _told_active(stored: StoredRadioMap) -> None:
    typer.echo(f"{stored.radio_map_id}, version {stored.version}, is active")


def _print_report(console: Console, report: BuildReport) -> None:
    counts = asdict(report)
    del counts["kept_out"]
    console.print(", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items()))
    for one in report.kept_out:
        console.print(f"kept out: {one.key} has {one.reason}: {one.evidence}", style="yellow")


def _print_comparison(console: Console, change: Comparison) -> None:
    lost = sum(place.rows_after == 0 for place in change.places)
    gained = sum(place.rows_before == 0 for place in change.places)
    console.print(f"transmitters: {len(change.gained)} gained, {len(change.lost)} lost")
    console.print(f"places: {gained} gained, {lost} lost, of {len(change.places)}")
    if change.error_before_m is not None:
        console.print(
            f"cross-validated error where both know the place: {change.error_before_m:.2f} m "
            f"before, {change.error_after_m:.2f} m after"
        )
    levels = Table("transmitter", "change dB", "places", title="Heard otherwise")
    for one in change.levels[:_SHOWN]:
        levels.add_row(one.key, f"{one.change_db:+.1f}", str(one.cells))
    places = Table("floor", "x", "y", "before m", "after m", title="Places that changed most")
    for floor_id, x_m, y_m, before_m, after_m in _most_changed(change)[:_SHOWN]:
        places.add_row(floor_id, f"{x_m:.1f}", f"{y_m:.1f}", f"{before_m:.1f}", f"{after_m:.1f}")
    for table in (levels, places):
        if table.row_count:
            console.print(table)


def _most_changed(change: Comparison) -> list[tuple[str, float, float, float, float]]:
    both = [
        (place.floor_id, place.x_m, place.y_m, place.error_before_m, place.error_after_m)
        for place in change.places
        if place.error_before_m is not None and place.error_after_m is not None
    ]
    return sorted(both, key=lambda place: -abs(place[4] - place[3]))
