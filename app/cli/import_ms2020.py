"""``pharos import ms2020``: a building of the Indoor Location Competition 2.0 becomes a site."""

import math
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from app.cli.errors import CommandError
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.cli.usable_walks import usable_walks
from app.formats.ms2020 import fold_of, trace_id_of
from app.formats.ms2020_site import BuildingFolderError, read_building
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.building_import import (
    SiteImport,
    radio_map_of,
    refuse_existing,
    site_id_of,
    storing,
)

_CHUNK = 4


def import_ms2020(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Building with its floors in it.")],
    exclude_fold: Annotated[
        list[int] | None,
        typer.Option(min=0, max=3, help="Keep the walks of this fold out of the radio map."),
    ] = None,
    site: Annotated[
        str | None, typer.Option(metavar="NAME", help="Name of the site; default: the folder's.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Bring a site that is there already up to date.")
    ] = False,
    database: DatabaseOption = None,
) -> None:
    """Make a site of a building folder: floors, plans, walls, walkable area and radio map."""
    console = Console(stderr=True)
    try:
        building = read_building(folder)
    except (BuildingFolderError, OSError) as error:
        raise CommandError(str(error)) from error
    excluded = frozenset(exclude_fold or ())
    paths = [
        path
        for floor in building.floors
        for path in floor.traces
        if fold_of(trace_id_of(path)) not in excluded
    ]
    name = site or building.name
    with local_database(database) as store:
        if not replace:
            store.read_now(lambda c: refuse_existing(c, site_id_of(name)))
        walks = _read_walks(paths, console)
        wanted = SiteImport(
            name=name,
            building=building,
            radio_map=radio_map_of(building, site_id_of(name), walks),
            provenance={
                "format": "ms2020",
                "walks": len(walks),
                "excluded_folds": sorted(excluded),
            },
        )
        stored = store.write_now(storing(wanted, CLOCK.now_s(), overwrite=replace))
    names = ", ".join(floor.name for floor in building.floors)
    console.print(
        f"Floors {names}; radio map of {len(walks)} walks: "
        f"{stored.fingerprints} fingerprints, {stored.transmitters} transmitters"
    )
    typer.echo(stored.site_id)


def _read_walks(paths: Sequence[Path], console: Console) -> list[SurveyWalk]:
    """Read traces on all cores; those that cannot be used are named with their reason."""
    reading = track(
        _parsed(paths), "Reading walks", total=len(paths), console=console, transient=True
    )
    walks = list(usable_walks(paths, reading, console))
    if not walks:
        msg = "no walk in it can be used for a radio map; nothing was stored"
        raise CommandError(msg)
    return walks


def _parsed(paths: Sequence[Path]) -> Iterator[SurveyWalk | str]:
    # Fresh interpreters: a fork would copy the progress display's thread half-way.
    context = multiprocessing.get_context("spawn")
    workers = min(os.cpu_count() or 1, math.ceil(len(paths) / _CHUNK))
    with ProcessPoolExecutor(max(workers, 1), mp_context=context) as pool:
        yield from pool.map(survey_walk_or_reason, paths, chunksize=_CHUNK)
