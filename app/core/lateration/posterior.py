"""Lateration by the posterior: where a phone may be, given the levels of known anchors.

Equation
--------
Anchor i's local mean level ``u_i`` in the window (`app.core.radio.local_mean`) is expected to be
``h_i(p) = u_i*(p) - L_i(p) + o``: log-distance level, loss in walls, and the phone's offset ``o ~
N(o_0, sigma_o^2)``. Shadowing is normal; but with the probability ``f_i`` the anchor is not what it
was, and any level within a span S is as likely. With ``z_i = (u_i - h_i) / s_i``::

    p(u_i | p, o) = (1 - f_i) N(z_i) / s_i + f_i / S
    -2 log p(p | u) = -2 sum log p(u_i | p, o) + (o - o_0)^2 / sigma_o^2 + prior(p)

``o`` is the one that fits best at p, by reweighting: without faults that is the same as integrating
it out.

The answer is the posterior's mean and covariance over a box, not its mode: the surface is no
parabola, and the mean has the least squared error of all answers. ``s_i^2 = sigma_i^2 (1 + rho (M -
1)) / M`` for M readings whose deviations have the correlation rho (Kish's design effect):
shadowing is fixed to the place, so many readings tell little more than one.

Sources: Bayes; Roos et al., "A probabilistic approach to WLAN user location estimation", 2002 (the
posterior on a grid); Grinyak et al. 2018 (level model).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numba import njit

from app.core.lateration.surface import outside_cost, spread_over
from app.core.radio.local_mean import local_means_dbm
from app.core.radio.path_loss import (
    DZ2,
    INTERCEPT,
    SIGMA,
    SLOPE,
    LevelModel,
    X,
    Y,
    squared_distance,
)
from app.core.radio.wall_losses import NO_LOSS, loss_at
from app.core.radio.windows import Window
from app.core.types import FloatArray, IntArray

PLAN_SIGMA_M = 0.5
"""Plans are drawn about so exactly: farther outside the outer walls nobody is."""

SPAN_DB = 60.0
"""Levels between deafening and silence."""

USUAL_FAULT = 1.0 / 150.0
"""One anchor in 150 is not where, or not what, the registry says."""

CELLS = 21
"""Cells per side of the grid: of a metre or so, a quarter of the posterior's own width."""

ROUNDS = 3
"""Reweightings of the offset; more change it by less than a tenth of a decibel."""


Costs: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]
"""From x and y of places (n,), m, to -2 log-likelihoods (n,)."""

LossMaps: TypeAlias = Sequence[FloatArray] | FloatArray
"""Per anchor the map of what walls take (see `app.core.radio.wall_losses`); `stacked`, they are
copied only once."""


@dataclass(frozen=True, slots=True)
class PhoneOffset:
    """What is believed of how much more a phone hears than the calibrated one, dB."""

    mean_db: float = 0.0
    sigma_db: float = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalLevels:
    """Local mean levels of the anchors heard, each array (anchors,).

    Attributes
    ----------
    anchor_index
        Rows of the level model.
    level_dbm, sigma_db
        The mean, and how far it may be from the model's.
    time_s
        Mean time of the readings.
    moved_m : (anchors, 2)
        How the phone has moved since.
    """

    anchor_index: IntArray
    level_dbm: FloatArray
    sigma_db: FloatArray
    time_s: FloatArray
    moved_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlacePosterior:
    """What levels tell of the place.

    Attributes
    ----------
    mean : (2,)
    covariance : (2, 2)
    offset
        The phone's, at the mean.
    log_evidence_ratio
        Logarithm of the levels' likelihood (see `costs_of`) averaged over where phones are.
    """

    mean: FloatArray
    covariance: FloatArray
    offset: PhoneOffset
    log_evidence_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class PlacePrior:
    """Where phones are before anything is heard.

    Attributes
    ----------
    box : (7,)
        Around the anchors, see `app.core.lateration.surface.box_around`: people are where the
        anchors were put, and rarely farther outside than a third of its margin. Levels outweigh
        that, but when the phone's offset is unknown they do not tell a place inside the circle
        through the anchors from its inversion outside.
    plan_m : (4,)
        Left, low, right, high of the floor's plan, infinite where unknown: there is no way out.
    """

    box: FloatArray
    plan_m: FloatArray = field(default_factory=lambda: np.array([-np.inf, -np.inf, np.inf, np.inf]))


def local_levels(window: Window, model: LevelModel, correlation: float) -> LocalLevels:
    """Return the local means of a window's readings, which are sorted by anchor."""
    which, group, count = np.unique(window.anchor_index, return_inverse=True, return_counts=True)
    share = (1.0 + correlation * (count - 1)) / count
    return LocalLevels(
        anchor_index=which,
        level_dbm=local_means_dbm(group, window.rssi_dbm, len(which)),
        sigma_db=model.table[which, SIGMA] * np.sqrt(share),
        time_s=np.bincount(group, window.time_s, len(which)) / count,
        moved_m=np.zeros((len(which), 2)),
    )


def place_posterior(
    levels: LocalLevels,
    model: LevelModel,
    loss_db: LossMaps,
    offset: PhoneOffset,
    prior: PlacePrior,
    fault: FloatArray | None = None,
) -> PlacePosterior:
    """Return where a phone is that hears these levels.

    Parameters
    ----------
    levels
        Of at least one anchor; all on one floor.
    loss_db
        Per anchor heard, the map of what walls take (`app.core.radio.wall_losses.loss_map_db`).
    offset
        What is known of the phone before.
    prior
        Where phones are.
    fault : (anchors heard,)
        Probability that an anchor is at fault; `USUAL_FAULT` where nothing is known.
    """
    level_costs = costs_of(levels, model, loss_db, offset, fault)

    def costs_at(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        return level_costs(x_m, y_m) + _prior_costs(prior.box, prior.plan_m, x_m, y_m)

    mean, covariance, log_integral = spread_over(prior.box, costs_at, CELLS)
    found = offset_at(levels, model, loss_db, offset, mean)
    return PlacePosterior(mean, covariance, found, log_integral - math.log(_prior_m2(prior)))


def costs_of(
    levels: LocalLevels,
    model: LevelModel,
    loss_db: LossMaps,
    offset: PhoneOffset,
    fault: FloatArray | None = None,
) -> Costs:
    """Return what levels say of places, whatever is known of those: see `place_posterior`.

    What does not depend on the place is left out, so only differences mean something.
    """
    if fault is None:
        fault = np.full(len(levels.anchor_index), USUAL_FAULT)
    heard = _as_seen_now(levels, model)
    seen = (levels.level_dbm - offset.mean_db, levels.sigma_db**-2.0, stacked(loss_db))
    # Odds of a fault where the level is just the expected one.
    odds = fault / (1.0 - fault) * np.sqrt(2.0 * np.pi) * levels.sigma_db / SPAN_DB
    information = np.inf if offset.sigma_db == 0.0 else offset.sigma_db**-2.0

    def costs_at(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        return _level_costs(seen, heard, (odds, information), x_m, y_m)

    return costs_at


def residuals_db(
    levels: LocalLevels, model: LevelModel, loss_db: LossMaps, place: FloatArray
) -> FloatArray:
    """Return measured minus expected level (anchors,) at a place (2,), for a phone of offset 0."""
    return np.asarray(residuals_at(levels, model, loss_db, place[None, :])[0])


def residuals_at(
    levels: LocalLevels, model: LevelModel, loss_db: LossMaps, places: FloatArray
) -> FloatArray:
    """Return the same for several places (places, 2): (places, anchors)."""
    heard = _as_seen_now(levels, model)
    seen = (levels.level_dbm, levels.sigma_db, stacked(loss_db))
    residual = np.empty((len(places), len(heard)))
    for row, (x_m, y_m) in zip(residual, places.tolist(), strict=True):
        _fill_residuals(seen, heard, x_m, y_m, row)
    return residual


def offset_at(
    levels: LocalLevels,
    model: LevelModel,
    loss_db: LossMaps,
    offset: PhoneOffset,
    place: FloatArray,
) -> PhoneOffset:
    """Return what is known of the phone's offset after it heard these levels at a place (2,)."""
    if offset.sigma_db == 0.0:
        return offset
    weight = levels.sigma_db**-2.0
    residual = residuals_db(levels, model, loss_db, place) - offset.mean_db
    information = float(weight.sum()) + offset.sigma_db**-2.0
    mean_db = offset.mean_db + float(weight @ residual) / information
    return PhoneOffset(mean_db, information**-0.5)


def _as_seen_now(levels: LocalLevels, model: LevelModel) -> FloatArray:
    """Return the heard anchors' rows, moved along with the phone since it heard them."""
    heard = model.table[levels.anchor_index]
    heard[:, X : Y + 1] += levels.moved_m
    return heard


def stacked(loss_db: LossMaps) -> FloatArray:
    """Return the maps in one array (anchors, cells, cells); one that is, as it is."""
    if isinstance(loss_db, np.ndarray):
        return loss_db
    cells = max(len(loss) for loss in loss_db)
    shape = (cells, cells)
    return np.array([loss if loss is not NO_LOSS else np.zeros(shape) for loss in loss_db])


def _prior_m2(prior: PlacePrior) -> float:
    """Return the area over which the place prior spreads: of its bell, or of the plan within."""
    side_m = 2.0 * (prior.box[4:6] - prior.box[6]) + prior.box[6] * math.sqrt(2.0 * math.pi) / 3.0
    plan_side_m = prior.plan_m[2:] - prior.plan_m[:2] + PLAN_SIGMA_M * math.sqrt(2.0 * math.pi)
    return float(min(side_m.prod(), plan_side_m.prod()))


@njit(cache=True)
def _prior_costs(
    box: FloatArray, plan_m: FloatArray, x_m: FloatArray, y_m: FloatArray
) -> FloatArray:  # pragma: no cover - compiled
    costs = np.empty(len(x_m))
    for m in range(len(x_m)):
        off_x = max(plan_m[0] - x_m[m], x_m[m] - plan_m[2], 0.0) / PLAN_SIGMA_M
        off_y = max(plan_m[1] - y_m[m], y_m[m] - plan_m[3], 0.0) / PLAN_SIGMA_M
        costs[m] = outside_cost(box, x_m[m], y_m[m]) + off_x * off_x + off_y * off_y
    return costs


@njit(cache=True)
def _level_costs(
    seen: tuple[FloatArray, FloatArray, FloatArray],
    heard: FloatArray,
    belief: tuple[FloatArray, float],
    x_m: FloatArray,
    y_m: FloatArray,
) -> FloatArray:  # pragma: no cover - compiled
    weight = seen[1]
    residual = np.empty(len(weight))
    costs = np.empty(len(x_m))
    for m in range(len(x_m)):
        _fill_residuals(seen, heard, x_m[m], y_m[m], residual)
        costs[m] = _level_cost(residual, weight, belief)
    return costs


@njit(cache=True)
def _level_cost(
    residual_db: FloatArray, weight: FloatArray, belief: tuple[FloatArray, float]
) -> float:  # pragma: no cover - compiled
    """Return -2 log-likelihood of the levels and of the offset that fits them best."""
    odds, offset_information = belief
    offset = 0.0
    for turn in range(ROUNDS):
        weighted, total = 0.0, offset_information
        for i in range(len(weight)):
            healthy = 1.0
            if turn > 0:
                z2 = weight[i] * (residual_db[i] - offset) ** 2
                healthy = 1.0 / (1.0 + odds[i] * math.exp(min(0.5 * z2, 50.0)))
            weighted += healthy * weight[i] * residual_db[i]
            total += healthy * weight[i]
        offset = weighted / total
    cost = 0.0 if math.isinf(offset_information) else offset * offset * offset_information
    for i in range(len(weight)):
        z2 = weight[i] * (residual_db[i] - offset) ** 2
        cost -= 2.0 * math.log((math.exp(-0.5 * z2) + odds[i]) / (1.0 + odds[i]))
    return cost


@njit(cache=True)
def _fill_residuals(
    seen: tuple[FloatArray, FloatArray, FloatArray],
    heard: FloatArray,
    x_m: float,
    y_m: float,
    residual_db: FloatArray,
) -> None:  # pragma: no cover - compiled
    level_dbm, _, loss_db = seen
    for i in range(len(level_dbm)):
        dx, dy = x_m - heard[i, X], y_m - heard[i, Y]
        expected = heard[i, INTERCEPT] - loss_at(loss_db[i], dx, dy)
        expected -= 0.5 * heard[i, SLOPE] * np.log(squared_distance(dx, dy, heard[i, DZ2]))
        residual_db[i] = level_dbm[i] - expected
