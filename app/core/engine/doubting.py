"""Anchors under suspicion: which ones lateration leaves out, and what a scan says of each."""

from dataclasses import replace

import numpy as np

from app.core.engine.anchoring import anchor_floors, wall_loss_db
from app.core.engine.place import place_of
from app.core.engine.state import SessionState, changed
from app.core.lateration.faults import (
    FaultParams,
    at_fault,
    fault_probability,
    heard_evidence,
    judged,
    silent_evidence,
)
from app.core.lateration.posterior import LocalLevels, PhoneOffset, residuals_db
from app.core.params import Params
from app.core.radio.path_loss import SIGMA, LevelModel, level_gradients
from app.core.site import SiteModel
from app.core.types import FloatArray

FAULTS = FaultParams()

NEW_AT_MOST = 0.5
"""Share of a scan's levels that is news, at most: windows overlap by half."""

NEWS_GAIN = 4.0
"""How much more than one level's the news of all of them is: where shadowing errs, the filter's
place follows some of it, and what is left of it changes sooner than the shadowing itself."""

NEAR_M = 15.0
"""No beacon is loud from farther away."""


def fault_of_heard(state: SessionState, levels: LocalLevels, site: SiteModel) -> FloatArray:
    """Return the probability (anchors,) that each of the anchors heard is at fault.

    Where too many are, the filter is lost, and none is believed to be more than usual.
    """
    odds = state.lateration.fault_log_odds
    heard = [site.anchors[i].anchor_id for i in levels.anchor_index]
    if odds and not at_fault(odds, len(heard), FAULTS):
        odds = {anchor_id: min(value, 0.0) for anchor_id, value in odds.items()}
    return fault_probability(odds, heard, FAULTS)


def left_out(state: SessionState, heard: int) -> tuple[str, ...]:
    """Return the ids of the anchors that are more likely at fault than not."""
    return tuple(sorted(at_fault(state.lateration.fault_log_odds, heard, FAULTS)))


def doubt(
    state: SessionState,
    scan: tuple[LocalLevels, LevelModel, float],
    elapsed_s: float,
    where: tuple[SiteModel, int],
    params: Params,
) -> SessionState:
    """Judge the anchors by a scan, from the place that the filter now holds.

    Parameters
    ----------
    scan
        The levels, the anchors' models, and how many independent scans' worth this one is.
    elapsed_s
        Since the scan before.
    where
        The site, and the floor's index.
    """
    if state.track is None:
        return state
    site, floor = where
    levels, model, worth = scan
    place, covariance = place_of(state.track)
    offset = state.lateration.offset or PhoneOffset(0.0, params.lateration.offset_prior_db)
    news = min(NEWS_GAIN * worth, NEW_AT_MOST)
    evidence = {}
    loss_db = [wall_loss_db(site, int(i)) for i in levels.anchor_index]
    residual = residuals_db(levels, model, loss_db, place) - offset.mean_db
    unsure = _place_variance_db2(model, place, covariance)
    for i, residual_db in zip(levels.anchor_index, residual.tolist(), strict=True):
        sigma_db = float(np.sqrt(model.table[i, SIGMA] ** 2 + unsure[i] + offset.sigma_db**2))
        found = heard_evidence(residual_db, sigma_db)
        evidence[site.anchors[i].anchor_id] = news * found
    for i in _silent(levels, model, (site, floor), place, offset):
        evidence[site.anchors[i].anchor_id] = NEW_AT_MOST * silent_evidence(FAULTS)
    odds = judged(state.lateration.fault_log_odds, evidence, elapsed_s, FAULTS)
    return changed(state, lateration=replace(state.lateration, fault_log_odds=odds))


def _place_variance_db2(model: LevelModel, place: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return how much of each level's variance the place's own uncertainty is, (anchors,)."""
    gradient = level_gradients(model, place[:1], place[1:])[0]
    return np.asarray(np.einsum("ia,ab,ib->i", gradient, covariance, gradient))


def _silent(
    levels: LocalLevels,
    model: LevelModel,
    where: tuple[SiteModel, int],
    place: FloatArray,
    offset: PhoneOffset,
) -> list[int]:
    """Return the anchors of the floor that are not heard where they would be loud."""
    site, floor = where
    on_floor = np.flatnonzero(anchor_floors(site) == floor)
    unheard = np.setdiff1d(on_floor, levels.anchor_index)
    near = unheard[np.hypot(*(model.table[unheard, :2] - place).T) < NEAR_M]
    if not len(near):
        return []
    nothing = LocalLevels(
        near, np.zeros(len(near)), np.ones(len(near)), np.zeros(len(near)), np.zeros((len(near), 2))
    )
    loss_db = [wall_loss_db(site, int(i)) for i in near]
    expected_dbm = offset.mean_db - residuals_db(nothing, model, loss_db, place)
    loud_dbm = levels.level_dbm.min() + FAULTS.loud_db
    return [int(i) for i in near[expected_dbm > loud_dbm]]
