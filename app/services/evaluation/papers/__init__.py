"""What the papers claim, reproduced: one module per published system, named as its profile."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from app.services.evaluation.figures import Figures
from app.services.evaluation.papers import blunavi2020, grinyak2018, liu2016, tao2016, zhu2018
from app.services.evaluation.parallel import on_all_cores


class Paper(Protocol):
    """The module of a paper: how it is reproduced, in words and as a function of the seeds."""

    PROTOCOL: str

    def reproduce(self, seeds: Sequence[int]) -> Figures:
        """Return the figures; those of `over_seeds` where they differ between seeds."""


PAPERS: Mapping[str, Paper] = {
    "grinyak2018": grinyak2018,
    "blunavi2020": blunavi2020,
    "liu2016": liu2016,
    "zhu2018": zhu2018,
    "tao2016": tao2016,
}


def reproduced(names: Sequence[str], seeds: Sequence[int]) -> Iterator[Figures]:
    """Yield the figures of papers, in the order of their names."""
    return on_all_cores(_reproduce, [(name, tuple(seeds)) for name in names], chunk=1)


def _reproduce(task: tuple[str, tuple[int, ...]]) -> Figures:
    name, seeds = task
    return PAPERS[name].reproduce(seeds)
