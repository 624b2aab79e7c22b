"""Figures of an evaluation, in the form that it is printed, stored and documented in."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

Figures: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What one data set says: figures by profile, or by method where no profile is at work.

    ``command`` prints the same again.
    """

    dataset: str
    command: str
    protocol: str
    profiles: Mapping[str, Figures]


def over_seeds(values: Sequence[float], target: float | None = None) -> dict[str, float | None]:
    """Return what a figure is over the seeds of a simulation, and what it ought to be."""
    p10, median, p90 = (float(p) for p in np.percentile(values, (10.0, 50.0, 90.0)))
    return {"median": median, "p10": p10, "p90": p90, "target": target}


def error_figures(errors_m: ArrayLike) -> dict[str, float]:
    """Return mean, median and percentiles of errors; NaN of none."""
    errors = np.asarray(errors_m, dtype=np.float64)
    if not len(errors):
        errors = np.array([math.nan])
    return {
        "mean_error_m": float(np.mean(errors)),
        "median_error_m": float(np.median(errors)),
        "p75_error_m": float(np.percentile(errors, 75.0)),
        "p95_error_m": float(np.percentile(errors, 95.0)),
    }
