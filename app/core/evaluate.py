"""Scores of positions against truth, by one protocol for every estimator.

A walk is scored once a second from its first scan on: what was answered at that moment against
where the phone was. A second without an answer is scored at the last position given and counted as
one without a fix; while none was given yet there is nothing to measure, so it is only counted.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from app.core.types import BleScan, FloatArray, Observation, WifiScan

DECILES = 10


@dataclass(frozen=True, slots=True)
class Place:
    """A position in the site frame."""

    floor_id: str
    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class Answer(Place):
    """A position as it was told, with the radius that should hold the truth in 95 of 100 cases."""

    radius95_m: float


@dataclass(frozen=True, slots=True)
class RecordedSecond:
    """What was observed in ``[end_s - 1, end_s)``, and whether the answer at its end counts."""

    end_s: int
    observations: tuple[Observation, ...]
    is_scored: bool


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
    answer: Answer | None
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
    mean_error_m, median_error_m, p75_error_m, p95_error_m
        Of the horizontal errors; NaN without samples.
    floor_right_share
        Share of the samples on the right floor.
    no_fix, no_fix_share
        Seconds, measured or not, that got no position of their own, and their share of all.
    lost_share
        Share of the samples that got no position of their own: the rest of ``no_fix`` lies before a
        walk's first fix.
    coverage95_share, mean_radius95_m
        Share of the truth inside the radius told, and the mean radius, over the seconds that got a
        position of their own: an older one claims nothing of the present.
    coverage95_share_by_decile : (10,)
        The same in each tenth of those seconds, from the smallest radii to the largest.
    """

    samples: int
    mean_error_m: float
    median_error_m: float
    p75_error_m: float
    p95_error_m: float
    floor_right_share: float
    no_fix: int
    no_fix_share: float
    lost_share: float
    coverage95_share: float
    mean_radius95_m: float
    coverage95_share_by_decile: tuple[float, ...]


def recorded_seconds(observations: Iterable[Observation]) -> Iterator[RecordedSecond]:
    """Cut a recording into whole event seconds, gaps and all; from its first scan on they count."""
    batches: dict[int, list[Observation]] = {}
    first_scan_s = math.inf
    for observation in observations:
        batches.setdefault(math.floor(observation.time_s), []).append(observation)
        if isinstance(observation, WifiScan | BleScan):
            first_scan_s = min(first_scan_s, observation.time_s)
    for second in range(min(batches, default=0), max(batches, default=-1) + 1):
        end_s = second + 1
        yield RecordedSecond(end_s, tuple(batches.get(second, ())), end_s >= first_scan_s)


def hold_last(
    truth: Sequence[tuple[float, Place]], answers: Sequence[Answer | None]
) -> list[ScoredSecond]:
    """Pair the truth at each second with the answer given then, or else with the last one given."""
    seconds: list[ScoredSecond] = []
    last: Answer | None = None
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
    lost = sum(s.no_fix for s, _ in measured)
    right = sum(s.answer is not None and s.answer.floor_id == s.truth.floor_id for s in every)
    radii_m, inside = _claims(every)
    return Score(
        samples=len(measured),
        mean_error_m=float(np.mean(errors_m)),
        median_error_m=float(np.median(errors_m)),
        p75_error_m=float(np.percentile(errors_m, 75.0)),
        p95_error_m=float(np.percentile(errors_m, 95.0)),
        floor_right_share=right / len(measured) if measured else math.nan,
        no_fix=no_fix,
        no_fix_share=no_fix / len(every) if every else math.nan,
        lost_share=lost / len(measured) if measured else math.nan,
        coverage95_share=_mean(inside),
        mean_radius95_m=_mean(radii_m),
        coverage95_share_by_decile=tuple(_mean(part) for part in np.array_split(inside, DECILES)),
    )


def _claims(seconds: Iterable[ScoredSecond]) -> tuple[FloatArray, FloatArray]:
    """Return the radii told, ascending, and 1 where the truth lies inside, else 0."""
    claims = [
        (s.answer.radius95_m, s.error_m <= s.answer.radius95_m)
        for s in seconds
        if s.answer is not None and s.error_m is not None and not s.no_fix
    ]
    radii_m, inside = np.array(sorted(claims), dtype=np.float64).reshape(-1, 2).T
    return radii_m, inside


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if len(values) else math.nan
