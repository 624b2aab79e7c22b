"""``pharos evaluate survey-report`` and ``ageing``: what radio maps say of themselves, checked."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

import typer
from rich.console import Console

from app.cli.evaluate_ms2020 import chosen_building
from app.cli.evaluate_output import JsonOption, give
from app.cli.usable_walks import usable_walks
from app.services.evaluation import ageing, single_scans, survey_report
from app.services.evaluation.figures import Evaluation, Figures
from app.services.evaluation.ms2020 import TEST, Split

Folder: TypeAlias = Annotated[
    Path, typer.Argument(metavar="DIR", help="Building with its floors in it.")
]
FloorsOption: TypeAlias = Annotated[
    str | None, typer.Option(metavar="F1,F2", help="Only these floors, in map and traces.")
]
TestOption: TypeAlias = Annotated[
    bool, typer.Option("--test/--tuning", help="Ask fold 0, or each of folds 1 to 3 in turn.")
]


def evaluate_survey_report(
    folder: Folder,
    floors: FloorsOption = None,
    test: TestOption = True,
    json_file: JsonOption = None,
) -> None:
    """Compare the error that a radio map predicts by place with that of scans it never saw."""
    give(_evaluated(folder, floors, "survey-report", test, survey_report.report_figures), json_file)


def evaluate_ageing(
    folder: Folder,
    floors: FloorsOption = None,
    seeds: Annotated[int, typer.Option(min=1, help="Permutations drawn.")] = 5,
    test: TestOption = True,
    json_file: JsonOption = None,
) -> None:
    """Permute identities of transmitters, find them in traffic, and match without them."""

    def figures(held: single_scans.HeldOut) -> Figures:
        return ageing.ageing_figures(held, range(seeds))

    give(_evaluated(folder, floors, f"ageing --seeds {seeds}", test, figures), json_file)


def _evaluated(
    folder: Path,
    floors: str | None,
    command: str,
    test: bool,
    figures: Callable[[single_scans.HeldOut], Figures],
) -> Evaluation:
    building = chosen_building(folder, floors)
    paths = single_scans.trace_paths(building)
    read = single_scans.read_traces(paths)
    walks = list(usable_walks(paths, read, Console(stderr=True)))
    names = ",".join(floor.name for floor in building.floors)
    splits: tuple[Split, ...] = (TEST,) if test else single_scans.TUNING_SPLITS
    name, _, options = command.partition(" ")
    choice = "--test" if test else "--tuning"
    return Evaluation(
        dataset=f"ms2020 {building.name} {names} {name}",
        command=f"pharos evaluate {name} DIR --floors {names} {options} {choice}".replace(
            "  ", " "
        ),
        protocol=single_scans.PROTOCOL,
        profiles={
            f"fold {split.asked}": figures(single_scans.held_out(building, walks, split))
            for split in splits
        },
    )
