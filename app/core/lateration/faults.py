"""Anchors that are not where, or not what, the registry says: moved, doubled or dead.

Equation
--------
The log-odds ``l_i`` that anchor i is at fault start at ``l_0`` and forget with time. Each scan adds
what it tells, times how much of it is new (``w``: shadowing errs alike around a place)::

    l_i <- l_0 + (l_i - l_0) exp(-dt / T) + w d_i
    heard:   d_i = z_i^2 / 2 - ln(span / (sqrt(2 pi) s_i)),   z_i = (u_i - h_i(p)) / s_i
    silent:  d_i = ln(1 / (1 - p_heard))                      where it would have been loud

``p`` is where the filter holds the phone to be, ``s_i^2 = sigma_i^2 + g_i' P g_i`` shadowing and
what the filter does not know. A healthy anchor's residual is normal; one that was moved or doubled
gives any level within the span; a dead one none. Above 0 an anchor is more likely at fault than not
and is left out. Where more than a share of the anchors is, the place is wrong, and not they.

Sources: Bayes; Page, "Continuous inspection schemes", Biometrika 41, 1954 (accumulating such
log-likelihood ratios).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from app.core.lateration.posterior import SPAN_DB
from app.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class FaultParams:
    """What is believed of faults.

    Attributes
    ----------
    prior_log_odds_ratio
        One anchor in fifty is at fault.
    most_log_odds_ratio
        Bound of the log-odds: a mended anchor is believed again after as many scans as a bad one
        took.
    memory_s
        T above: a minute or two of walking past an anchor.
    heard_share
        Share of the windows in which a loud anchor is heard; scanners pause, advertisements
        collide.
    loud_db
        This far above the weakest level heard an anchor is loud: three times the usual shadowing.
    most_share
        No more than this share of the anchors is ever at fault.
    """

    prior_log_odds_ratio: float = -4.0
    most_log_odds_ratio: float = 4.0
    memory_s: float = 90.0
    heard_share: float = 0.97
    loud_db: float = 15.0
    most_share: float = 0.34


def heard_evidence(residual_db: float, sigma_db: float) -> float:
    """Return d of an anchor that was heard."""
    z = residual_db / sigma_db
    return 0.5 * z * z - math.log(SPAN_DB / (math.sqrt(2.0 * math.pi) * sigma_db))


def silent_evidence(params: FaultParams) -> float:
    """Return d of an anchor that was not heard where it would have been loud."""
    return -math.log(1.0 - params.heard_share)


def judged(
    log_odds: Mapping[str, float],
    evidence: Mapping[str, float],
    elapsed_s: float,
    params: FaultParams,
) -> dict[str, float]:
    """Return the log-odds after a scan; anchors that are not in it are at the prior.

    Parameters
    ----------
    log_odds
        Before, by anchor.
    evidence
        ``w d`` by anchor, of those that the scan speaks of.
    elapsed_s
        Since the scan before.
    """
    prior = params.prior_log_odds_ratio
    kept = math.exp(-elapsed_s / params.memory_s)
    out = {}
    for anchor_id in log_odds.keys() | evidence.keys():
        before = log_odds.get(anchor_id, prior)
        after = prior + (before - prior) * kept + evidence.get(anchor_id, 0.0)
        # Healthy for an hour is no reason to need an hour to see that it was moved.
        after = min(max(after, prior), params.most_log_odds_ratio)
        if after > prior + 1e-3:
            out[anchor_id] = after
    return dict(sorted(out.items()))


def fault_probability(
    log_odds: Mapping[str, float], anchor_ids: Sequence[str], params: FaultParams
) -> FloatArray:
    """Return the probability (anchors,) that each of these is at fault."""
    odds = [log_odds.get(anchor_id, params.prior_log_odds_ratio) for anchor_id in anchor_ids]
    return np.asarray(1.0 / (1.0 + np.exp(-np.array(odds))))


def at_fault(log_odds: Mapping[str, float], heard: int, params: FaultParams) -> frozenset[str]:
    """Return the anchors to leave out, of so many heard: none where they would be too many."""
    bad = frozenset(anchor_id for anchor_id, odds in log_odds.items() if odds > 0.0)
    return bad if len(bad) <= max(1.0, params.most_share * heard) else frozenset()
