"""``pharos evaluate papers``: what the published systems claim, by seeded simulation."""

from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption, give
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.papers import PAPERS, reproduced


def evaluate_papers(
    seeds: Annotated[
        int, typer.Option(min=1, metavar="N", help="Simulate so many times, seeds 0 to N - 1.")
    ] = 20,
    only: Annotated[
        str | None, typer.Option(metavar="NAMES", help="Only these papers, joined by commas.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Repeat the experiments of the papers behind the profiles, and compare with what they say."""
    names = _papers(only)
    figures = track(
        reproduced(names, range(seeds)),
        "Repeating experiments",
        total=len(names),
        console=Console(stderr=True),
        transient=True,
    )
    chosen = "" if only is None else f" --only {','.join(names)}"
    give(
        Evaluation(
            dataset="papers",
            command=f"pharos evaluate papers --seeds {seeds}{chosen}",
            protocol="\n".join(f"{name}: {PAPERS[name].PROTOCOL}" for name in names),
            profiles=dict(zip(names, figures, strict=True)),
        ),
        json_file,
    )


def _papers(names: str | None) -> list[str]:
    if names is None:
        return list(PAPERS)
    chosen = list(dict.fromkeys(names.split(",")))
    for name in chosen:
        if name not in PAPERS:
            msg = f"there is no paper {name!r}; there are: {', '.join(PAPERS)}"
            raise CommandError(msg, 2)
    return chosen
