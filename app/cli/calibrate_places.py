"""``pharos calibrate places``: where beacons are that nobody measured."""

from typing import Annotated

import typer

from app.cli.calibrate_report import print_draft
from app.cli.calibrate_source import (
    AskedSource,
    DeviceOption,
    SessionOption,
    SurveyOption,
    TraceOption,
    drafted_places,
)
from app.cli.evaluate_output import JsonOption
from app.cli.local import DatabaseOption
from app.services.calibration_drafts import PlacesRequest


def calibrate_places(  # noqa: PLR0913 - one parameter per option
    floor: Annotated[str, typer.Argument(metavar="FLOOR", help="Id of a floor.")],
    survey: SurveyOption = None,
    device: DeviceOption = None,
    session: SessionOption = None,
    trace: TraceOption = None,
    beacon: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID", help="Whom to place; left out: all that have no place. May be repeated."
        ),
    ] = None,
    register_unknown: Annotated[
        bool,
        typer.Option("--register-unknown", help="Place those too that nobody registered."),
    ] = False,
    json_file: JsonOption = None,
    database: DatabaseOption = None,
) -> None:
    """Estimate where beacons of a floor are, with covariance, and print the draft's id.

    Of one source: a survey, a session with truth records, or recorded traces. The registry is not
    touched before `pharos calibrate apply`.
    """
    asked = PlacesRequest(tuple(beacon) if beacon else None, register_unknown)
    source = AskedSource(survey, device, session, tuple(trace or ()))
    print_draft(drafted_places(database, floor, source, asked), json_file)
