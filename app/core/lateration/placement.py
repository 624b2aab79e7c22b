"""Where the next anchors help most, and how few of them reach a bound.

Both are searches over a list of possible anchors with the objective, to be made small::

    A = mean over cells of max(tr D', b^2)

``D'`` is the covariance with a prior of `app.core.lateration.planning`, ``b = 0`` for the best next
anchors and the bound for the fewest that reach it: beyond the bound a cell counts no more. An
anchor changes ``J`` of the cells that hear it by a rank-one term ``h h'``; so trying a candidate
costs a few multiplications per cell, whatever hangs on the floor already.

- Next anchors: greedy, one after the other (A-optimal design).
- Fewest anchors: greedy until every cell keeps the bound, then the least useful one is taken away
  and the others are exchanged, one at a time, for better candidates, as long as that lowers ``A``;
  if the bound is kept again, once more. It ends at a layout from which no single exchange leads to
  one anchor less. That is few, not provably the fewest: the problem contains set cover.

Sources: Fedorov, Theory of Optimal Experiments, 1972 (exchange); Krause, McMahan, Guestrin and
Gupta, JMLR 9, 2008 (greedy on a truncated objective for a worst-case bound).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.lateration.planning import (
    HEARD,
    FixRule,
    Ground,
    Scale,
    gradient,
    information,
    scale_of,
    trace,
    traces,
)
from app.core.radio.path_loss import LevelModel
from app.core.radio.walls import HearingParams, heard
from app.core.types import BoolArray, FloatArray, IntArray

PRIOR_BOUNDS = 100.0
"""Prior of a search for a bound, in bounds: it moves a sigma at the bound by 1 in 10^4 at most."""

BOUND_SLACK = 1e-3
"""By this much less than b^2 is aimed at, so that what the weak prior adds cannot break it."""

MAX_EXCHANGE_SCANS = 300
"""Scans of all candidates that exchanges may cost: each takes up to about 0.1 s."""

MIN_GAIN = 1e-6
"""Exchanges that lower the objective by a smaller share are rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Choices:
    """Anchors that could be added to a layout.

    ``model`` has a row for each; ``rule`` says which fixes are to be bettered.
    """

    model: LevelModel
    hearing: HearingParams
    rule: FixRule


@dataclass(frozen=True, slots=True)
class Cover:
    """Candidates (rows of the choices) to add for a bound, and whether it is kept everywhere."""

    chosen: tuple[int, ...]
    reached: bool


def best_additions(
    ground: Ground, present: FloatArray, choices: Choices, count: int
) -> tuple[int, ...]:
    """Return the candidates to add next, best first.

    Parameters
    ----------
    present : (cells, 4)
        Information of the anchors there are (`information`).
    count
        How many to choose; fewer are returned where no candidate helps any more.
    """
    search = _Search(ground, present, choices, ground.prior_m2, 0.0)
    return tuple(search.greedy(count))


def fewest_for_bound(
    ground: Ground, present: FloatArray, choices: Choices, bound_m: float, at_most: int
) -> Cover:
    """Return few candidates that bring sigma_xy to ``bound_m`` or below in every cell.

    Parameters
    ----------
    present : (cells, 4)
        Information of the anchors there are, which stay.
    at_most
        The search for a layout gives up with this many.
    """
    prior_m2 = (PRIOR_BOUNDS * bound_m) ** 2
    search = _Search(ground, present, choices, prior_m2, bound_m**2 * (1.0 - BOUND_SLACK))
    chosen = search.greedy(at_most)
    if not search.is_reached(chosen):
        return Cover(tuple(chosen), reached=False)
    while chosen:
        fewer = search.one_less(chosen)
        if fewer is None:
            break
        chosen = fewer
    return Cover(tuple(chosen), reached=True)


class _Search:
    """The candidates' state that greedy and exchange share; ``_scans`` counts what was spent."""

    def __init__(
        self,
        ground: Ground,
        present: FloatArray,
        choices: Choices,
        prior_m2: float,
        target_m2: float,
    ) -> None:
        self._places = (ground.x_m, ground.y_m)
        self._ground, self._present, self._model = ground, present, choices.model
        self._audible: BoolArray = heard(
            choices.model, ground.x_m, ground.y_m, ground.walls, choices.hearing
        )
        self._rule, self._prior_m2, self._target_m2 = choices.rule, prior_m2, target_m2
        self._scans = 0

    def greedy(self, count: int) -> list[int]:
        """Return up to ``count`` candidates, each the best after those before it."""
        chosen: list[int] = []
        J = self._present.copy()
        most = min(count, self._model.anchors)
        while len(chosen) < most and self._excess(J) > 0.0:
            best, gain = self._best(J, chosen)
            if gain <= 0.0:
                break
            chosen.append(best)
            J += self._information([best])
        return chosen

    def is_reached(self, chosen: Sequence[int]) -> bool:
        """Return whether every cell keeps the target."""
        return bool(self._excess(self._present + self._information(chosen)) <= 0.0)

    def one_less(self, chosen: Sequence[int]) -> list[int] | None:
        """Return a layout of one candidate less that keeps the target, None if none is found."""
        without = [[c for c in chosen if c != left_out] for left_out in chosen]
        excess = [self._excess(self._present + self._information(w)) for w in without]
        trial = without[int(np.argmin(excess))]
        least = min(excess)
        while least > 0.0:
            before = least
            for place in range(len(trial)):
                if self._scans >= MAX_EXCHANGE_SCANS:
                    return None
                trial, least = self._exchanged(trial, place, least)
                if least <= 0.0:
                    return trial
            if least >= before * (1.0 - MIN_GAIN):
                return None
        return trial

    def _exchanged(self, trial: list[int], place: int, excess_m2: float) -> tuple[list[int], float]:
        """Return the layout with one candidate replaced by the best, if that is better."""
        self._scans += 1
        others = [c for i, c in enumerate(trial) if i != place]
        J = self._present + self._information(others)
        best, gain = self._best(J, others)
        after = self._excess(J) - gain
        if best == trial[place] or after >= excess_m2 * (1.0 - MIN_GAIN):
            return trial, excess_m2
        replaced = [*trial[:place], best, *trial[place + 1 :]]
        return replaced, self._excess(self._present + self._information(replaced))

    def _best(self, J: FloatArray, taken: Sequence[int]) -> tuple[int, float]:
        scale = (scale_of(self._rule, self._prior_m2), self._target_m2)
        gains = _gains(self._model.table, self._places, self._audible, J, scale)
        gains[list(taken)] = 0.0
        best = int(np.argmax(gains))
        return best, float(gains[best])

    def _excess(self, J: FloatArray) -> float:
        """Return the sum over the cells of ``max(tr D' - b^2, 0)``."""
        return float(np.maximum(traces(J, self._rule, self._prior_m2) - self._target_m2, 0.0).sum())

    def _information(self, chosen: Sequence[int]) -> FloatArray:
        rows = list(chosen)
        model = LevelModel(self._model.table[rows])
        return information(model, self._ground, self._audible[rows])


@njit(cache=True, nogil=True)
def _gains(
    table: FloatArray,
    places: tuple[FloatArray, FloatArray],
    audible: BoolArray,
    J: FloatArray,
    scale: tuple[Scale, float],
) -> FloatArray:
    """Return by how much each candidate would lower the excess, (candidates,)."""
    x, y = places
    fix, target = scale
    excess = np.empty(len(J))
    for cell in range(len(J)):
        excess[cell] = trace(J[cell, 0], J[cell, 1], J[cell, 2], int(J[cell, HEARD]), fix) - target
    # Near a bound few cells still exceed it, and only they count.
    open_cells: IntArray = np.nonzero(excess > 0.0)[0]
    gains = np.zeros(len(table))
    for k in range(len(table)):
        row = table[k]
        for i in range(len(open_cells)):
            c = open_cells[i]
            if audible[k, c]:
                hx, hy = gradient(row, x[c], y[c])
                xx, xy, yy = J[c, 0] + hx * hx, J[c, 1] + hx * hy, J[c, 2] + hy * hy
                after = trace(xx, xy, yy, int(J[c, HEARD]) + 1, fix) - target
                gains[k] += excess[c] - max(after, 0.0)
    return gains
