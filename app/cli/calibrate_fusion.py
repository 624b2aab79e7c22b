"""``pharos calibrate fusion``: the weights of liu2016, fitted on labelled walks."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption
from app.cli.files import write_file
from app.cli.usable_walks import usable_walks
from app.core.fusion.blending import Three
from app.core.fusion.blending_weights import Unidentified, WeightFit
from app.formats.ms2020 import Trace, floor_folder_of, read_trace
from app.formats.ms2020_site import BuildingFolder, BuildingFolderError, read_building
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.evaluation.parallel import on_all_cores
from app.services.fusion_calibration import (
    FusionCalibration,
    calibrated_fusion,
    calibration_site,
    map_paths,
)

SOURCES = ("last", "Wi-Fi", "sensors")
# What the walks notice least is told by the weights that take a real part in it.
LEAST_PART = 0.3


def calibrate_fusion(
    traces: Annotated[
        list[Path],
        typer.Argument(metavar="TRACE...", help="Walks with waypoints, in their floors' folders."),
    ],
    building: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Building folder; default: the one that has the floors."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Fit how much the last value, Wi-Fi and the sensors count in liu2016's speed and heading.

    The radio map is made of all other walks of the building.
    """
    console = Console(stderr=True)
    walks = [_trace(path) for path in traces]
    folder = _building(building or floor_folder_of(traces[0].resolve()).parent)
    _refuse_strangers(walks, folder)
    site = calibration_site(folder, list(_surveyed(map_paths(folder, traces), console)))
    found = calibrated_fusion(walks, site)
    text = msgspec.json.format(msgspec.json.encode(asdict(found))) + b"\n"
    if json_file == Path("-"):
        typer.echo(text.decode(), nl=False)
        return
    _print(found)
    if json_file is not None:
        write_file(json_file, text)


def _trace(path: Path) -> Trace:
    try:
        trace = read_trace(path)
    except (ValueError, OSError) as error:
        msg = f"{path} cannot be used: {error}"
        raise CommandError(msg) from error
    if len(trace.waypoints) < 2:
        msg = f"{path} cannot be used: it needs two waypoints, where the walk was known"
        raise CommandError(msg)
    return trace


def _building(folder: Path) -> BuildingFolder:
    try:
        return read_building(folder)
    except (BuildingFolderError, OSError) as error:
        msg = f"{error}; --building says where the building is"
        raise CommandError(msg) from error


def _refuse_strangers(walks: Sequence[Trace], building: BuildingFolder) -> None:
    floors = [floor.name for floor in building.floors]
    for walk in walks:
        if walk.floor_name not in floors:
            msg = f"{walk.trace_id} is of floor {walk.floor_name!r}; there are: {', '.join(floors)}"
            raise CommandError(msg)


def _surveyed(paths: Sequence[Path], console: Console) -> Iterator[SurveyWalk]:
    if not paths:
        msg = "there is no other walk in the building to make a radio map of"
        raise CommandError(msg)
    reading = track(
        on_all_cores(survey_walk_or_reason, paths),
        "Reading walks",
        total=len(paths),
        console=console,
        transient=True,
    )
    return usable_walks(paths, reading, console)


def _print(found: FusionCalibration) -> None:
    console = Console()
    table = Table(title=f"Weights from {found.traces} walks")
    table.add_column("")
    for source in SOURCES:
        table.add_column(source, justify="right")
    for letter, name, before, fit in (
        ("w", "speed", found.before.speed_weights, found.fit.speed),
        ("u", "heading", found.before.heading_weights, found.fit.heading),
    ):
        table.add_row(f"{name}, published {letter}", *(f"{weight:.2f}" for weight in before))
        table.add_row(f"{name}, fitted {letter}", *_cells(fit))
    console.print(table)
    for name, fit in (("speed", found.fit.speed), ("heading", found.fit.heading)):
        if isinstance(fit, Unidentified):
            console.print(f"The walks do not tell the weights of the {name}: {_advice(fit)}")
    console.print(
        f"Mean error on these walks: {found.before_error_m:.2f} m with the published weights, "
        f"{found.after_error_m:.2f} m with the fitted ones"
    )


def _cells(fit: WeightFit | Unidentified) -> Iterator[str]:
    if isinstance(fit, Unidentified):
        yield from ("?",) * len(SOURCES)
        return
    for weight, sigma in zip(fit.weights, fit.sigmas, strict=True):
        yield f"{weight:.2f} ± {sigma:.2f}"


def _advice(fit: Unidentified) -> str:
    return (
        f"{_open(fit.trade)} open after {fit.epochs} scans. More walks help, with corners and "
        "stops in them."
    )


def _open(trade: Three) -> str:
    parts = zip(SOURCES, trade, strict=True)
    names = [source for source, part in parts if abs(part) >= LEAST_PART]
    if len(names) == 1:
        return f"that of {names[0]} is"
    return f"those of {' and '.join(names)} are"
