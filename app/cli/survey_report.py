"""``pharos survey report`` and ``ageing``: what a radio map of the local database is worth."""

import asyncio
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from app.api.survey_report_formats import report_html, report_json
from app.cli.errors import CommandError
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.services.ageing import AgeingService
from app.services.survey_reports import ReportedMap, report_of
from app.storage.ageing import AgedTransmitter

RadioMapArgument = Annotated[
    str, typer.Argument(metavar="RADIO_MAP", help="Id of a radio map, as the API lists it.")
]


def report(
    radio_map: RadioMapArgument,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all of it as JSON.")
    ] = None,
    html_file: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write a page to be printed.")
    ] = None,
    database: DatabaseOption = None,
) -> None:
    """Tell in metres how good a radio map is, and where to survey next."""
    if html_file is not None and find_spec("matplotlib") is None:
        msg = "--html needs matplotlib: install pharos[plots]"
        raise CommandError(msg, 2)
    with local_database(database) as store:
        reported = store.read_now(lambda c: report_of(c, radio_map))
    document = report_json(reported, CLOCK.now_s())
    for name in ("floors", "thin_spots", "conflicts", "wrong_floors"):
        Console().print(_table(name.replace("_", " "), document[name]))
    if json_file is not None:
        _write(json_file, msgspec.json.encode(document))
    if html_file is not None:
        _write(html_file, _page(document, reported))


def _page(document: dict[str, object], reported: ReportedMap) -> bytes:
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
    return await service.quarantine(radio_map_id, [a.suspect.key for a in aged], quarantined=True)


def _table(title: str, rows: list[dict[str, object]]) -> Table:
    table = Table(title=title)
    for name in rows[0] if rows else ("none",):
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    return table


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"the report cannot be written: {error}"
        raise CommandError(msg) from error
