"""Recorded walks that can be used; of the others it is said why not."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rich.console import Console

from app.formats.ms2020 import floor_folder_of
from app.formats.ms2020_survey import SurveyWalk


def usable_walks(
    paths: Sequence[Path], read: Iterable[SurveyWalk | str], console: Console
) -> Iterator[SurveyWalk]:
    """Yield the walks that can be used, and say of the others why not."""
    for path, walk in zip(paths, read, strict=True):
        if isinstance(walk, SurveyWalk):
            yield walk
        else:
            pass_over(path, walk, console)


def pass_over(path: Path, reason: str, console: Console) -> None:
    """Say that a trace is not used, and why."""
    console.print(
        f"{floor_folder_of(path).name}/{path.name} is passed over: {reason}", style="yellow"
    )
