"""What every evaluation gives: a table, and one JSON object if asked for."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from app.cli.files import write_file
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.report import columns_of, flat

JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the figures; - for stdout.")
]


NAME_WIDTH, NUMBER_WIDTH = 20, 7
"""A narrow terminal folds names, not figures: 100.0 % has seven characters."""


def give(evaluation: Evaluation, json_file: Path | None) -> None:
    """Print the figures as a table, and write them as JSON; to ``-`` the JSON alone."""
    text = msgspec.json.format(msgspec.json.encode(asdict(evaluation))) + b"\n"
    if json_file == Path("-"):
        typer.echo(text.decode(), nl=False)
        return
    Console().print(figures_table(evaluation))
    if json_file is not None:
        write_file(json_file, text)


def figures_table(evaluation: Evaluation) -> Table:
    """Return a table with a row per figure and a column per profile, method or statistic."""
    columns = {name: dict(flat(figures)) for name, figures in columns_of(evaluation).items()}
    table = Table(title=evaluation.dataset, caption=evaluation.protocol)
    table.add_column("", overflow="fold", min_width=NAME_WIDTH)
    for name in columns:
        table.add_column(name, justify="right", overflow="fold", min_width=NUMBER_WIDTH)
    for row in dict.fromkeys(name for column in columns.values() for name in column):
        table.add_row(row, *(column.get(row, "") for column in columns.values()))
    return table
