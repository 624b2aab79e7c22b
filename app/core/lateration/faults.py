"""Anchors that are not where, or not what, the registry says: dead, moved or duplicated.

Equation
--------
Each anchor has log-odds ``l_k`` of every fault k against being healthy. They start at ``l_0`` and
forget with time; each scan adds what it tells, times how much of it is new (``w``: shadowing errs
alike around a place)::

    l_k <- l_0 + (l_k - l_0) exp(-dt / T) + w ln(p_k / p_healthy)

With ``r = u - h(p)`` the level heard less the one expected, where the place p is only known as well
as the filter holds it (its spread stands in points of weight w_j), S the span of levels, and e the
share of surprises that no model explains:

    heard       p_healthy = (1 - e) sum w_j N(r_j; s) + e / S,  p_moved = 1 / S,  p_dead = e / S,
                p_duplicated = [p_healthy + sum w_j P(N(0; s) < r_j) / S] / 2
    not heard   p_healthy = p_duplicated = 1 - p_heard,  p_moved = 1 / 2,  p_dead = 1
    where it would have been loud

Powers add, so a second transmitter makes an anchor louder, never quieter; readings of two levels at
once are evidence of their own (`app.core.lateration.two_levels`). ``s`` is the anchor's shadowing,
or the scatter of the scan's residuals where that is larger: then the place is wrong, or the phone
covered, and nobody is to be blamed. An anchor that is more likely at fault than not is named and
left out; short of that it counts fully. Where more than a share of the anchors is, the place is
wrong, and not they.

Sources: Bayes; Page, "Continuous inspection schemes", Biometrika 41, 1954 (accumulating such
log-likelihood ratios); Julier and Uhlmann, "Unscented filtering", Proc. IEEE 92, 2004 (the points).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr

from app.core.types import FloatArray


class Fault(StrEnum):
    """What may be wrong with an anchor."""

    DEAD = "dead"
    MOVED = "moved"
    DUPLICATED = "duplicated"


LIKELY_SPAN_DB = 40.0
"""Levels of a beacon that is heard from anywhere: from faint to loud."""

DEAD, MOVED, DUPLICATED = range(len(Fault))

LogOdds: TypeAlias = tuple[float, ...]
"""Of each `Fault`, in their order, against being healthy."""


@dataclass(frozen=True, slots=True)
class FaultParams:
    """What is believed of faults.

    Attributes
    ----------
    prior_log_odds_ratio
        Of each kind: one anchor in fifty has it.
    most_log_odds_ratio
        Bound of the log-odds: a mended anchor is believed again after as many scans as a bad one
        took.
    memory_s
        T above: a minute or two of walking past an anchor.
    heard_share
        Share of the windows in which a loud anchor is heard; scanners pause, advertisements
        collide.
    surprise_share
        e above; it bounds what one scan can say against an anchor.
    most_share
        No more than this share of the anchors is ever at fault.
    told_ratio
        The kind is told where it is this many times as likely as each other one.
    """

    prior_log_odds_ratio: float = -4.0
    most_log_odds_ratio: float = 4.0
    memory_s: float = 90.0
    heard_share: float = 0.97
    surprise_share: float = 0.005
    most_share: float = 0.34
    told_ratio: float = 3.0


def heard_evidence(
    residual_db: FloatArray,
    weight: FloatArray,
    sigma_db: FloatArray,
    params: FaultParams,
) -> FloatArray:
    """Return ``ln(p_k / p_healthy)`` of anchors that were heard, (anchors, kinds).

    Parameters
    ----------
    residual_db : (points, anchors)
        Level heard less the one expected, from each point where the phone may be.
    weight : (points,)
        Of the points; their sum is 1.
    sigma_db : (anchors,)
        How far levels are from the model's.
    """
    surprise = params.surprise_share
    z = residual_db / sigma_db
    normal = weight @ np.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sigma_db)
    healthy = (1.0 - surprise) * normal + surprise / LIKELY_SPAN_DB
    doubled = 0.5 * (healthy + weight @ ndtr(z) / LIKELY_SPAN_DB)
    evidence = np.empty((residual_db.shape[1], len(Fault)))
    evidence[:, DEAD] = math.log(surprise / LIKELY_SPAN_DB) - np.log(healthy)
    evidence[:, MOVED] = -math.log(LIKELY_SPAN_DB) - np.log(healthy)
    evidence[:, DUPLICATED] = np.log(doubled / healthy)
    return evidence


def silent_evidence(
    above_db: FloatArray, weight: FloatArray, sigma_db: FloatArray, params: FaultParams
) -> FloatArray:
    """Return ``ln(p_k / p_healthy)`` of anchors that were not heard, (anchors, kinds).

    Parameters
    ----------
    above_db : (points, anchors)
        Level expected less the weakest one heard, at each point where the phone may be.
    weight, sigma_db
        As in `heard_evidence`.
    """
    missed = 1.0 - params.heard_share
    silent = weight @ (missed + (1.0 - missed) * ndtr(-above_db / sigma_db))
    evidence = np.zeros((above_db.shape[1], len(Fault)))
    evidence[:, DEAD] = -np.log(silent)
    evidence[:, MOVED] = np.maximum(np.log(0.5 / silent), 0.0)
    return evidence


def judged(
    log_odds: Mapping[str, LogOdds],
    evidence: Mapping[str, Sequence[float]],
    elapsed_s: float,
    params: FaultParams,
) -> dict[str, LogOdds]:
    """Return the log-odds after a scan; anchors that are not in it are at the prior.

    Parameters
    ----------
    log_odds
        Before, by anchor.
    evidence
        ``w ln(p_k / p_healthy)`` by anchor, of those that the scan speaks of.
    elapsed_s
        Since the scan before.
    """
    prior = params.prior_log_odds_ratio
    kept = math.exp(-elapsed_s / params.memory_s)
    ids = sorted(log_odds.keys() | evidence.keys())
    if not ids:
        return {}
    usual, nothing = (prior,) * len(Fault), (0.0,) * len(Fault)
    before = np.array([log_odds.get(anchor_id, usual) for anchor_id in ids])
    after = prior + (before - prior) * kept
    after += np.array([evidence.get(anchor_id, nothing) for anchor_id in ids])
    # The likeliest at its bound, the others as far below it as they were.
    after -= np.maximum(after.max(axis=1, keepdims=True) - params.most_log_odds_ratio, 0.0)
    # Healthy for an hour is no reason to need an hour to see that it was moved.
    after = np.maximum(after, prior)
    worth_keeping = after.max(axis=1) > prior + 1e-3
    return {
        anchor_id: tuple(odds)
        for anchor_id, odds, keep in zip(ids, after.tolist(), worth_keeping, strict=True)
        if keep
    }


def at_fault(
    log_odds: Mapping[str, LogOdds], heard: int, params: FaultParams
) -> dict[str, Fault | None]:
    """Return the anchors to leave out, of so many heard, and what is wrong with each.

    None: that cannot be told yet. None at all are left out where they would be too many.
    """
    bad = {
        anchor_id: _kind(odds, params)
        for anchor_id, odds in sorted(log_odds.items())
        if max(odds) > -math.log(len(Fault)) and math.fsum(map(math.exp, odds)) > 1.0
    }
    return bad if len(bad) <= max(1.0, params.most_share * heard) else {}


def _kind(odds: LogOdds, params: FaultParams) -> Fault | None:
    first, second = sorted(odds, reverse=True)[:2]
    if first - second < math.log(params.told_ratio):
        return None
    return tuple(Fault)[odds.index(first)]
