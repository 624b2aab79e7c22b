"""``pharos evaluate ms2020``: the engine on the held-out walks of a building."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption, give
from app.cli.usable_walks import pass_over, usable_walks
from app.core.engine import PROFILES
from app.formats.ms2020_site import BuildingFolder, BuildingFolderError, read_building
from app.formats.ms2020_survey import SurveyWalk
from app.services.evaluation import ms2020
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.phones import PHONES


def evaluate_ms2020(  # noqa: PLR0913 - options of a command
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Building with its floors in it.")],
    floors: Annotated[
        str | None, typer.Option(metavar="F1,F2", help="Only these floors, in map and traces.")
    ] = None,
    map_share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Share of each floor's walks in the map.")
    ] = 1.0,
    profile: Annotated[
        str, typer.Option(metavar="NAMES", help="Profiles, joined by commas, or all.")
    ] = "best",
    phone: Annotated[
        str, typer.Option(metavar="NAME", help=f"As another phone posts: {', '.join(PHONES)}.")
    ] = "recorded",
    json_file: JsonOption = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Draw the error curve and every trace on its plan."),
    ] = None,
) -> None:
    """Follow the walks of fold 0 with a map of the others, and compare with the truth."""
    draw = None if plot is None else _drawing_into(plot)
    profiles = _profiles(profile)
    _known(phone, PHONES, "phone")
    building = chosen_building(folder, floors)
    tasks = ms2020.tasks_of(building, profiles, phone)
    console = Console(stderr=True)
    splits = {task.split for task in tasks}
    sites = ms2020.sites_of(building, _walks(building, console), splits, map_share)
    walking = ms2020.score_traces(tasks, sites)
    following = track(walking, "Following walks", total=len(tasks), console=console, transient=True)
    scored = list(_followed(tasks, following, console))
    if not any(task.split == ms2020.TEST for task, _ in scored):
        msg = "no trace of fold 0 can be used"
        raise CommandError(msg)
    names = ",".join(floor.name for floor in building.floors)
    share = "" if map_share == 1.0 else f" --map-share {map_share:g}"
    share += "" if phone == "recorded" else f" --phone {phone}"
    give(
        Evaluation(
            dataset=f"ms2020 {building.name} {names}{share}",
            command=f"pharos evaluate ms2020 DIR --floors {names} --profile {profile}{share}",
            protocol=ms2020.PROTOCOL,
            profiles={name: ms2020.figures_of(scored, name) for name in profiles},
        ),
        json_file,
    )
    if draw is not None:
        draw(building, scored)


def _drawing_into(
    plot: Path,
) -> Callable[[BuildingFolder, Sequence[tuple[ms2020.Task, ms2020.ScoredTrace]]], None]:
    try:
        from app.cli.evaluate_plots import plot_walks  # noqa: PLC0415 - it needs an extra
    except ModuleNotFoundError as error:
        msg = f"--plot needs {error.name}: install pharos[plots]"
        raise CommandError(msg, 2) from error
    return partial(plot_walks, plot)


def _profiles(names: str) -> list[str]:
    if names == "all":
        return list(PROFILES)
    chosen = list(dict.fromkeys(names.split(",")))
    for name in chosen:
        _known(name, PROFILES, "profile")
    return chosen


def _known(name: str, names: Iterable[str], kind: str) -> None:
    if name not in names:
        msg = f"there is no {kind} {name!r}; there are: {', '.join(names)}"
        raise CommandError(msg, 2)


def chosen_building(folder: Path, floors: str | None) -> BuildingFolder:
    """Read a building, or only some of its floors."""
    try:
        building = read_building(folder)
    except (BuildingFolderError, OSError) as error:
        raise CommandError(str(error)) from error
    if floors is None:
        return building
    wanted = frozenset(floors.split(","))
    there = [floor.name for floor in building.floors]
    if unknown := sorted(wanted - set(there)):
        msg = f"there is no floor {unknown[0]!r} in it; there are: {', '.join(there)}"
        raise CommandError(msg, 2)
    return replace(building, floors=tuple(f for f in building.floors if f.name in wanted))


def _followed(
    tasks: Sequence[ms2020.Task],
    following: Iterable[ms2020.ScoredTrace | str],
    console: Console,
) -> Iterator[tuple[ms2020.Task, ms2020.ScoredTrace]]:
    """Yield the traces that can be used, and say of each other one once why not."""
    said = set[Path]()
    for task, scored in zip(tasks, following, strict=True):
        if isinstance(scored, ms2020.ScoredTrace):
            yield task, scored
        elif task.path not in said:
            said.add(task.path)
            pass_over(task.path, scored, console)


def _walks(building: BuildingFolder, console: Console) -> list[SurveyWalk]:
    paths = ms2020.map_paths(building)
    reading: Iterable[SurveyWalk | str] = track(
        ms2020.read_walks(building),
        "Reading walks",
        total=len(paths),
        console=console,
        transient=True,
    )
    return list(usable_walks(paths, reading, console))
