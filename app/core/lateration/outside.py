"""Whether a phone that hears anchors is on their plan at all, or hears them from outside.

A phone outside hears all anchors weakly. Within the plan a phone of less gain fits that almost as
well, so neither is ever sure of one scan, and the place on the plan is right only if the phone is
on it.

Equation
--------
Two hypotheses are compared by their evidence, the levels' likelihood (see
`app.core.lateration.posterior`) averaged over where the phone may be: on the plan, as the posterior
does it, or outside, in any direction and at any distance alike on a logarithmic scale. The log-odds
of being outside forget with time and add up over scans, each counting by how much of it is new
(``w``: shadowing errs alike around a place)::

    l <- l_0 + (l - l_0) exp(-dt / T) + w ln(E_outside / E_plan)

On the plan the phone's offset is what the session has learned. That was learned on the premise that
the phone is on the plan, so outside it is what is known of phones at large.

A radius that holds the truth with 95 % has to reach outside, when the phone is there with more than
5 %: with ``P`` the probability of being outside, ``F`` the distribution of the distance from the
place told to where the phone would be then, and R the radius of the place on the plan::

    (1 - P) (1 - 0.05^(r^2 / R^2)) + P F(r) = 0.95

Sources: Bayes; Jeffreys, "Theory of Probability", 1939 (evidence; scales without a preferred size).
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.lateration.posterior import Costs, PhoneOffset
from app.core.types import FloatArray

DISTANCES_M = np.array([3.0, 5.0, 8.0, 12.0, 20.0, 32.0, 50.0, 80.0, 125.0])
"""Beyond the plan, each three fifths farther: 4 dB. Nearer is still the plan, farther nothing is
heard."""

_ANGLES_RAD = np.arange(12) * np.pi / 6.0
_AWAY = np.stack((np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)), axis=1)
_ON_SQUARE = _AWAY / np.abs(_AWAY).max(axis=1, keepdims=True)

MISS = 0.05
"""A radius for 95 %."""


@dataclass(frozen=True, slots=True)
class OutsideParams:
    """What is believed of phones outside.

    Chosen in the rooms of ``tests/accuracy/outside_walks.py`` with other seeds than it prints.

    Attributes
    ----------
    prior_log_odds_ratio
        Of the phones that hear anchors one in ten is outside.
    least_log_odds_ratio, most_log_odds_ratio
        Bounds of the log-odds: whoever leaves, or comes in, is noticed within some scans.
    memory_s
        T above: people stay some minutes.
    correlation_m
        Shadowing errs alike over about this way (Gudmundson 1991: some metres indoors).
    told_probability
        A phone that is outside as surely as radii are told has no place on the plan. Short of it,
        the radius tells.
    """

    prior_log_odds_ratio: float = math.log(0.1 / 0.9)
    least_log_odds_ratio: float = -4.0
    most_log_odds_ratio: float = 3.5
    memory_s: float = 300.0
    correlation_m: float = 3.0
    told_probability: float = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """Whether the phone is outside, and where it would be.

    Attributes
    ----------
    time_s
        When levels last told of it.
    log_odds_ratio
        Of being outside.
    places_m : (places, 2)
        Where it may be, if it is.
    weight : (places,)
        Their probabilities, if it is.
    """

    time_s: float
    log_odds_ratio: float
    places_m: FloatArray
    weight: FloatArray

    @property
    def probability(self) -> float:
        """Return that of being outside."""
        return 1.0 / (1.0 + math.exp(-self.log_odds_ratio))

    def is_told(self, params: OutsideParams) -> bool:
        """Return whether that is enough to say so."""
        return self.probability > params.told_probability


def places_around(plan_m: FloatArray) -> FloatArray:
    """Return places (places, 2) outside a plan, given by left, low, right and high (4,)."""
    centre_m, half_m = 0.5 * (plan_m[:2] + plan_m[2:]), 0.5 * (plan_m[2:] - plan_m[:2])
    wall_m = centre_m + half_m * _ON_SQUARE
    return np.asarray(wall_m[:, None] + DISTANCES_M[:, None] * _AWAY[:, None]).reshape(-1, 2)


def judged_outside(
    before: Outside | None,
    told: tuple[Costs, float, float],
    plan_m: FloatArray,
    time_s: float,
    params: OutsideParams,
) -> Outside:
    """Return the belief after a scan.

    Parameters
    ----------
    before
        None: nothing was believed.
    told
        What the levels cost at places for a phone of which nothing is known
        (`app.core.lateration.posterior.costs_of`), the log-evidence of the plan, and how much of
        the scan is new, 0 to 1.
    plan_m : (4,)
        Left, low, right, high.
    time_s
        Of the scan.
    """
    costs_at, plan_log_evidence, worth = told
    places_m = places_around(plan_m)
    costs = costs_at(places_m[:, 0], places_m[:, 1])
    lowest = float(costs.min())
    likelihood = np.exp(-0.5 * (costs - lowest))
    log_evidence = math.log(float(likelihood.mean())) - 0.5 * lowest
    prior = params.prior_log_odds_ratio
    kept = 0.0
    if before is not None:
        forgotten = math.exp((before.time_s - time_s) / params.memory_s)
        kept = (before.log_odds_ratio - prior) * forgotten
    log_odds_ratio = prior + kept + worth * (log_evidence - plan_log_evidence)
    least, most = params.least_log_odds_ratio, params.most_log_odds_ratio
    log_odds_ratio = min(max(log_odds_ratio, least), most)
    return Outside(time_s, log_odds_ratio, places_m, likelihood / likelihood.sum())


def offset_on_plan(
    learned: PhoneOffset,
    at_large: PhoneOffset,
    before: Outside | None,
    time_s: float,
    params: OutsideParams,
) -> PhoneOffset:
    """Return what is known of the offset of a phone that is on the plan now.

    What one that was told to be outside has learned of its offset was learned there, on the wrong
    premise. It may have come in since, and then nothing is known: a mixture of both, by its moments
    (Blom and Bar-Shalom 1988).
    """
    if before is None or not before.is_told(params) or learned.sigma_db == 0.0:
        return learned
    came = before.probability * (1.0 - math.exp((before.time_s - time_s) / params.memory_s))
    share = came / (came + 1.0 - before.probability)
    apart_db = learned.mean_db - at_large.mean_db
    variance_db2 = (1.0 - share) * learned.sigma_db**2 + share * at_large.sigma_db**2
    variance_db2 += share * (1.0 - share) * apart_db**2
    return PhoneOffset(learned.mean_db - share * apart_db, math.sqrt(variance_db2))


def reaching_radius95_m(radius95_m: float, place_m: FloatArray, outside: Outside) -> float:
    """Return the 95 % radius about a place (2,) on the plan, if the phone may be outside.

    ``radius95_m`` is what it would be otherwise; on the plan the error is taken for a plane normal.
    """
    share = outside.probability
    apart_m = np.hypot(*(outside.places_m - place_m).T)
    order = np.argsort(apart_m)
    within = 0.0
    for distance_m, weight in zip(apart_m[order], outside.weight[order], strict=True):
        # What the plan has to hold, as long as nothing farther outside is held.
        missed = 1.0 - (1.0 - MISS - share * within) / (1.0 - share)
        if missed > 0.0:
            reach_m = radius95_m * math.sqrt(max(math.log(missed) / math.log(MISS), 0.0))
            if reach_m <= distance_m:
                return reach_m
        within += float(weight)
        held = (1.0 - share) * (1.0 - MISS ** ((distance_m / radius95_m) ** 2))
        if held + share * within >= 1.0 - MISS:
            return float(distance_m)
    return float(apart_m.max())
