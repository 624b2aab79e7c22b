"""``pharos growth``: what a radio map would become by use, on the database of this machine.

A running server takes up what is activated here within seconds.
"""

import asyncio
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from app.cli.errors import CommandError
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.services.errors import found
from app.services.growth import Look, accept_look, discard_all, sessions_aside, taken_look
from app.services.site import load_site_model
from app.storage.database import Database
from app.storage.quarantine import count_quarantined
from app.storage.sites import get_site

growing = typer.Typer(no_args_is_help=True, help="Let a radio map grow from use.")

SiteArgument = Annotated[str, typer.Argument(metavar="SITE", help="Id of the site.")]

_SHOWN = 20


@growing.command("look")
def look(site: SiteArgument, database: DatabaseOption = None) -> None:
    """Tell what the sessions kept aside would change; takes up to a minute."""
    with local_database(database) as store:
        _print(store, _look(store, site))


@growing.command("accept")
def accept(
    site: SiteArgument,
    activate: Annotated[bool, typer.Option(help="Match with the new version at once.")] = True,
    database: DatabaseOption = None,
) -> None:
    """Look, make a new version of the radio map of what would join, and print its id."""
    with local_database(database) as store:
        seen = _look(store, site)
        _print(store, seen)
        if seen.radio_map is None:
            msg = "no session kept aside would join the radio map"
            raise CommandError(msg)
        stored = asyncio.run(accept_look(store, seen, CLOCK.now_s(), activate=activate))
    state = "active" if stored.active else "not active"
    Console(stderr=True).print(f"Version {stored.version} is {state}.")
    typer.echo(stored.radio_map_id)


@growing.command("discard")
def discard(site: SiteArgument, database: DatabaseOption = None) -> None:
    """Forget all sessions kept aside; they are not taken again."""
    with local_database(database) as store:
        found(store.read_now(lambda c: get_site(c, site)), "site", site)
        count = asyncio.run(discard_all(store, site, CLOCK.now_s()))
    typer.echo(f"{count} sessions forgotten")


def _look(store: Database, site_id: str) -> Look:
    site = found(store.read_now(lambda c: get_site(c, site_id)), "site", site_id)
    if not site.grow_map:
        hint = "no more sessions are kept aside: the site's grow_map is off (docs/map-growth.md)"
        Console(stderr=True).print(hint, style="yellow")
    model = found(store.read_now(lambda c: load_site_model(c, site_id)), "site", site_id)
    return taken_look(model, asyncio.run(sessions_aside(store, site_id)), CLOCK.now_s())


def _print(store: Database, seen: Look) -> None:
    console = Console(stderr=True)
    waiting = store.read_now(lambda c: count_quarantined(c, seen.site_id))
    console.print(
        f"{waiting} sessions kept aside, {len(seen.asked)} looked at: {len(seen.joining)} would "
        f"join with {seen.fingerprints} fingerprints in {len(seen.places)} places"
    )
    effect = seen.effect
    if effect is not None and effect.before_m is not None and effect.after_m is not None:
        console.print(
            f"cross-validated error of {effect.scans} surveyed scans: {effect.before_m:.2f} m "
            f"before, {effect.after_m:.2f} m after"
        )
    places = Table("floor", "x", "y", "fingerprints", title="Where it would grow most")
    for place in sorted(seen.places, key=lambda place: -place.fingerprints)[:_SHOWN]:
        cells = (f"{place.x_m:.1f}", f"{place.y_m:.1f}", str(place.fingerprints))
        places.add_row(place.floor_id, *cells)
    if places.row_count:
        console.print(places)
