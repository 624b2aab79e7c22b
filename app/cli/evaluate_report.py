"""``pharos evaluate report``: the page docs/accuracy.md from the figures of evaluations."""

from pathlib import Path
from typing import Annotated

import msgspec
import typer

from app.cli.errors import CommandError
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.report import report_page


def write_report(
    figures: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="JSON that evaluations wrote.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The page, Markdown.")],
) -> None:
    """Make a page of the figures of evaluations, in the order given."""
    evaluations = [_evaluation(path) for path in figures]
    try:
        out.write_text(report_page(evaluations), encoding="utf-8")
    except OSError as error:
        raise CommandError(str(error)) from error


def _evaluation(path: Path) -> Evaluation:
    try:
        return msgspec.json.decode(path.read_bytes(), type=Evaluation)
    except (OSError, msgspec.MsgspecError) as error:
        msg = f"{path}: {error}"
        raise CommandError(msg) from error
