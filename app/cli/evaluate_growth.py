"""``pharos evaluate growth``: what unlabelled walks bring to a map of few surveyed ones."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption, give
from app.formats.ms2020 import Trace, read_trace
from app.formats.ms2020_site import BuildingFolder, BuildingFolderError, read_building
from app.services.evaluation import growth
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.ms2020 import TEST, TUNING
from app.services.evaluation.parallel import on_all_cores

_SPLITS = {split.asked: split for split in (TUNING, TEST)}


def evaluate_growth(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Building with its floors in it.")],
    fold: Annotated[
        int, typer.Option(help="Ask the walks of fold 0, of a map of 1 to 3; or of 1, of 2 and 3.")
    ] = TEST.asked,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Deals of the walks.")] = 3,
    json_file: JsonOption = None,
) -> None:
    """Survey a quarter of the walks, let the map grow by half of them, and compare."""
    if fold not in _SPLITS:
        msg = f"--fold is one of {', '.join(map(str, sorted(_SPLITS)))}"
        raise CommandError(msg, 2)
    try:
        building = read_building(folder)
        traces = _traces(building)
    except (BuildingFolderError, OSError, ValueError) as error:
        raise CommandError(str(error)) from error
    figures = growth.growth_figures(building, traces, _SPLITS[fold], range(seeds))
    give(
        Evaluation(
            dataset=f"ms2020 {building.name} growth",
            command=f"pharos evaluate growth DIR --fold {fold} --seeds {seeds}",
            protocol=growth.PROTOCOL,
            profiles=dict(
                track(
                    figures,
                    "Growing maps",
                    total=seeds,
                    console=Console(stderr=True),
                    transient=True,
                )
            ),
        ),
        json_file,
    )


def _traces(building: BuildingFolder) -> list[Trace]:
    paths = [path for floor in building.floors for path in floor.traces]
    return list(on_all_cores(read_trace, paths))
