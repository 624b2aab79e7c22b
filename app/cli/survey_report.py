"""``pharos survey report`` and ``ageing``: what maps and surveys of this database are worth."""

import asyncio
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from app.api.survey_report_formats import report_html, report_json, survey_report_json
from app.cli.errors import CommandError
from app.cli.files import write_file
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.services.ageing import AgeingService
from app.services.survey_reports import Reported, report_of, report_of_survey
from app.storage.ageing import AgedTransmitter

RadioMapArgument = Annotated[
    str, typer.Argument(metavar="RADIO_MAP", help="Id of a radio map, as the API lists it.")
]


def report(
    radio_map: Annotated[
        str | None,
        typer.Argument(metavar="RADIO_MAP", help="Id of a radio map, as the API lists it."),
    ] = None,
    survey: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Instead of a radio map: the one this survey would make."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all of it as JSON.")
    ] = None,
    html_file: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write a page to be printed.")
    ] = None,
    database: DatabaseOption = None,
) -> None:
    """Tell in metres how good a radio map or a survey is, and where to survey next."""
    if html_file is not None and find_spec("matplotlib") is None:
        msg = "--html needs matplotlib: install pharos[plots]"
        raise CommandError(msg, 2)
    document, reported = _told(radio_map, survey, database)
    for name in ("floors", "thin_spots", "conflicts", "wrong_floors"):
        Console().print(_table(name.replace("_", " "), document[name]))
    if json_file is not None:
        write_file(json_file, msgspec.json.encode(document))
    if html_file is not None:
        write_file(html_file, _page(document, reported))


def _told(
    radio_map: str | None, survey: str | None, database: str | None
) -> tuple[dict[str, Any], Reported]:
    with local_database(database) as store:
        if radio_map is not None and survey is None:
            of_map = store.read_now(lambda c: report_of(c, radio_map))
            return report_json(of_map, CLOCK.now_s()), of_map.reported
        if survey is not None and radio_map is None:
            of_survey = store.read_now(lambda c: report_of_survey(c, survey))
            return survey_report_json(of_survey, CLOCK.now_s()), of_survey.reported
    msg = "name a radio map, or a survey by --survey"
    raise CommandError(msg, 2)


def _page(document: dict[str, Any], reported: Reported) -> bytes:
    from app.api.survey_report_picture import floor_pictures  # noqa: PLC0415 - it needs an extra

    return report_html(document, floor_pictures(reported))


def find_ageing(
    radio_map: RadioMapArgument,
    quarantine: Annotated[
        bool, typer.Option("--quarantine", help="Leave what is found out of matching.")
    ] = False,
    database: DatabaseOption = None,
) -> None:
    """Look for transmitters that vanished, moved or appeared in the last fortnight's traffic."""
    with local_database(database) as store:
        aged = asyncio.run(_look(AgeingService(store), radio_map, quarantine))
    rows: list[dict[str, object]] = [
        {
            "transmitter": a.suspect.key,
            "change": a.suspect.change.value,
            "excess": f"{a.suspect.excess:.2f}",
            "scans": a.suspect.scans,
            "quarantined": "yes" if a.quarantined else "no",
        }
        for a in aged
    ]
    Console().print(_table("aged transmitters", rows))


async def _look(
    service: AgeingService, radio_map_id: str, quarantine: bool
) -> list[AgedTransmitter]:
    aged = await service.look(radio_map_id, CLOCK.now_s())
    if not quarantine:
        return aged
    return await service.quarantine(radio_map_id, [a.suspect.key for a in aged], ())


def _table(title: str, rows: list[dict[str, object]]) -> Table:
    # Else the title of a narrow table is broken over several lines.
    table = Table(title=title, min_width=len(title))
    for name in rows[0] if rows else ("none",):
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    return table
