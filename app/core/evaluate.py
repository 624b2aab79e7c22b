"""Scores of positions against truth, by one protocol for every estimator.

A walk is scored once a second from its first scan on: what was answered at that moment against
where the phone was. A second without an answer is scored at the last position given and counted as
one without a fix; while none was given yet there is nothing to measure, so it is only counted.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Place:
    """A position in the site frame."""

    floor_id: str
    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class ScoredSecond:
    """One second of a walk.

    Attributes
    ----------
    truth
        Where the phone was.
    answer
        The last position given by then; None if none was given yet.
    no_fix
        True if the answer is an older second's.
    """

    time_s: float
    truth: Place
    answer: Place | None
    no_fix: bool

    @property
    def error_m(self) -> float | None:
        """Return the horizontal distance from truth to answer; floors do not count."""
        if self.answer is None:
            return None
        return math.hypot(self.answer.x_m - self.truth.x_m, self.answer.y_m - self.truth.y_m)


@dataclass(frozen=True, slots=True)
class Score:
    """Errors over all scored seconds of one walk or of many.

    Attributes
    ----------
    samples
        Seconds with a position to measure.
    mean_error_m, median_error_m, p95_error_m
        Of the horizontal errors; NaN without samples.
    floor_right_share
        Share of the samples on the right floor.
    no_fix, no_fix_share
        Seconds, measured or not, that got no position of their own, and their share of all.
    """

    samples: int
    mean_error_m: float
    median_error_m: float
    p95_error_m: float
    floor_right_share: float
    no_fix: int
    no_fix_share: float


def hold_last(
    truth: Sequence[tuple[float, Place]], answers: Sequence[Place | None]
) -> list[ScoredSecond]:
    """Pair the truth at each second with the answer given then, or else with the last one given."""
    seconds: list[ScoredSecond] = []
    last: Place | None = None
    for (time_s, place), answer in zip(truth, answers, strict=True):
        last = answer or last
        seconds.append(ScoredSecond(time_s, place, last, answer is None))
    return seconds


def score(seconds: Iterable[ScoredSecond]) -> Score:
    """Return the score of seconds, pooled: every second counts the same."""
    every = list(seconds)
    measured = [(s, s.error_m) for s in every if s.error_m is not None]
    errors_m = np.array([error_m for _, error_m in measured] or [math.nan], dtype=np.float64)
    no_fix = sum(s.no_fix for s in every)
    right = sum(s.answer is not None and s.answer.floor_id == s.truth.floor_id for s in every)
    return Score(
        samples=len(measured),
        mean_error_m=float(np.mean(errors_m)),
        median_error_m=float(np.median(errors_m)),
        p95_error_m=float(np.percentile(errors_m, 95.0)),
        floor_right_share=right / len(measured) if measured else math.nan,
        no_fix=no_fix,
        no_fix_share=no_fix / len(every) if every else math.nan,
    )
