"""``pharos evaluate survey-walks``: what placing scans along a surveyor's strides is worth."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption, give
from app.formats.ms2020_site import BuildingFolderError, read_building
from app.services.evaluation import survey_walks
from app.services.evaluation.figures import Evaluation


def evaluate_survey_walks(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Building with its floors in it.")],
    tracks: Annotated[
        bool, typer.Option("--tracks", help="Follow whole walks, too: takes minutes.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Compare maps of walks placed by smoothing with maps of walks placed on straight lines."""
    try:
        building = read_building(folder)
    except (BuildingFolderError, OSError) as error:
        raise CommandError(str(error)) from error
    walks = survey_walks.read_walks(building)
    if not walks:
        msg = "no walk of folds 1 to 3 in it can be used"
        raise CommandError(msg)
    figures = survey_walks.figures_of(building, walks, tracks=tracks)
    give(
        Evaluation(
            dataset=f"ms2020 {building.name}",
            command=f"pharos evaluate survey-walks DIR{' --tracks' if tracks else ''}",
            protocol=survey_walks.PROTOCOL,
            profiles=figures,
        ),
        json_file,
    )
