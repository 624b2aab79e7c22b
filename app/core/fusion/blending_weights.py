"""The weights of blending, fitted by least squares on walks with known positions.

Equations
---------
An epoch of a walk leads from the last output P to a fix, at whose time the walker truly was at T;
dt, V_i, O_i and e(O) as in `app.core.fusion.blending`. What would have been right::

    O_true = direction in which the walker truly went,   V_true = (T - P) . e(O) / dt

Speed: V_true = sum w_i V_i over all epochs. Heading: only the direction of the blend counts, not
its length, so the weights sum to 1, and what is minimised is the part of the blend across the true
heading, sum u_i sin(O_i - O_true).

P and V_last are the system's own, not the truth: with a true V_last the best weights would trust it
blindly, and a wrong place would never be corrected. So the epochs depend on the weights with which
the walk was followed: follow, fit, follow again.

Source: as `app.core.fusion.blending`; the paper fits by least squares, the form is ours.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.core.fusion.blending import BlendedMotion, BlendingParams, Three
from app.core.types import FloatArray

MAX_WEIGHT_SIGMA = 0.25
"""Weights lie between 0 and 1: at a larger standard error two of them span all that is possible."""

MIN_MOVED_M = 0.5
"""A walker who truly moved less has no heading to be compared with (a step is 0.7 m)."""


@dataclass(frozen=True, slots=True)
class LabelledEpoch:
    """What one epoch was blended of, and what would have been right.

    ``true_heading_rad`` is nan where the walker stood.
    """

    speeds: Three
    headings: Three
    true_speed_mps: float
    true_heading_rad: float


@dataclass(frozen=True, slots=True)
class WeightFit:
    """Fitted weights with their standard errors.

    ``residual_scale`` is the standard deviation of what they leave: m/s for speeds, and for
    headings the part of a unit vector across the true one (about radians).
    """

    weights: Three
    sigmas: Three
    residual_scale: float
    epochs: int


@dataclass(frozen=True, slots=True)
class Unidentified:
    """The walks do not tell the weights.

    ``trade`` (unit length) is the change of the weights that the walks notice least: those with
    large entries cannot be told apart.
    """

    trade: Three
    epochs: int


@dataclass(frozen=True, slots=True)
class FusionFit:
    """Both triples."""

    speed: WeightFit | Unidentified
    heading: WeightFit | Unidentified

    def onto(self, params: BlendingParams) -> BlendingParams:
        """Return parameters with what could be fitted."""
        speed, heading = self.speed, self.heading
        return BlendingParams(
            speed.weights if isinstance(speed, WeightFit) else params.speed_weights,
            heading.weights if isinstance(heading, WeightFit) else params.heading_weights,
        )


def labelled(
    before: BlendedMotion, after: BlendedMotion, from_true: FloatArray, to_true: FloatArray
) -> LabelledEpoch:
    """Return an epoch from the outputs at its ends and the true places (2,) there."""
    seconds = after.time_s - before.time_s
    missing = to_true - np.array([before.x_m, before.y_m])
    c, s = math.cos(after.heading_rad), math.sin(after.heading_rad)
    true_x, true_y = (to_true - from_true).tolist()
    stood = math.hypot(true_x, true_y) < MIN_MOVED_M
    return LabelledEpoch(
        speeds=after.speeds,
        headings=after.headings,
        true_speed_mps=float(missing[0] * c + missing[1] * s) / seconds,
        true_heading_rad=math.nan if stood else math.atan2(true_y, true_x),
    )


def fit_weights(epochs: Sequence[LabelledEpoch]) -> FusionFit:
    """Return w and u of labelled epochs; those that lack a source are passed over."""
    speeds = np.array([(*e.speeds, e.true_speed_mps) for e in epochs]).reshape(-1, 4)
    headings = np.array([(*e.headings, e.true_heading_rad) for e in epochs]).reshape(-1, 4)
    return FusionFit(_fit_speed(_known(speeds)), _fit_heading(_known(headings)))


def _known(rows: FloatArray) -> FloatArray:
    return rows[~np.isnan(rows).any(axis=1)]


def _fit_speed(rows: FloatArray) -> WeightFit | Unidentified:
    return _fit(rows[:, :3], rows[:, 3], np.eye(3), np.zeros(3))


def _fit_heading(rows: FloatArray) -> WeightFit | Unidentified:
    across = np.sin(rows[:, :3] - rows[:, 3:])
    # u3 = 1 - u1 - u2: two weights are free.
    of_free = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
    return _fit(across @ of_free, -across[:, 2], of_free, np.array([0.0, 0.0, 1.0]))


def _fit(
    design: FloatArray, target: FloatArray, of_free: FloatArray, fixed: FloatArray
) -> WeightFit | Unidentified:
    """Return the weights ``fixed + of_free b`` that minimise ``|design b - target|``."""
    epochs, free = design.shape
    singular, rows = np.linalg.svd(design)[1:]
    least_noticed = of_free @ rows[-1]
    trade = _three(least_noticed / np.linalg.norm(least_noticed))
    if epochs <= free or singular[-1] <= 1e-9 * singular[0]:
        return Unidentified(trade, epochs)
    b = np.linalg.lstsq(design, target)[0]
    variance = float(np.sum((design @ b - target) ** 2)) / (epochs - free)
    sigmas = np.sqrt(variance * np.sum((of_free @ (rows.T / singular)) ** 2, axis=1))
    if sigmas.max() > MAX_WEIGHT_SIGMA:
        return Unidentified(trade, epochs)
    return WeightFit(_three(fixed + of_free @ b), _three(sigmas), math.sqrt(variance), epochs)


def _three(vector: FloatArray) -> Three:
    first, second, third = vector.tolist()
    return first, second, third
