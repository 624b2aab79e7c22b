"""Anchors under suspicion: which ones lateration leaves out, and what a scan says of each."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from app.core.changed import changed
from app.core.engine.anchoring import anchor_floors, wall_loss_db
from app.core.engine.place import place_of
from app.core.engine.state import SessionState
from app.core.lateration.faults import (
    DUPLICATED,
    Fault,
    FaultParams,
    at_fault,
    heard_evidence,
    judged,
    silent_evidence,
)
from app.core.lateration.posterior import (
    USUAL_FAULT,
    LocalLevels,
    PhoneOffset,
    residuals_at,
)
from app.core.lateration.two_levels import two_levels
from app.core.params import Params
from app.core.radio.path_loss import DZ2, SIGMA, SLOPE, LevelModel
from app.core.radio.windows import Window
from app.core.site import SiteModel
from app.core.types import FloatArray, IntArray

FAULTS = FaultParams()

LEFT_OUT_FAULT = 0.99
"""Nothing is left of the anchor's word, yet the likelihood stays finite."""

NEW_AT_MOST = 0.5
"""Share of a scan's levels that is news, at most: windows overlap by half, and by more where scans
come more often than every second."""

NEWS_GAIN = 4.0
"""How much more than one level's the news of all of them is: where shadowing errs, the filter's
place follows some of it, and what is left of it changes sooner than the shadowing itself."""

NEAR_M = 15.0
"""No beacon is loud from farther away."""

SURE_OF_FLOOR = 0.99
"""On stairs, levels of either floor are wrong, and no anchor is to blame."""

OFFSET_SIGMA_DB = 3.0
"""Hands and bodies move about a phone: its offset is never known better."""

HEIGHT_M = 1.2
"""Phones are so much higher or lower than the profile takes them to be."""

POINT_WEIGHT = np.array([1.0 / 3.0, *[1.0 / 6.0] * 4])
POINT_SIGMAS = np.sqrt(3.0) * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=float)
"""Points with a normal distribution's moments in the plane, in standard deviations."""

ROBUST_SIGMA = 1.4826
"""Standard deviation over the median of absolute deviations, of normal ones."""


def left_out(state: SessionState, heard: int) -> dict[str, Fault | None]:
    """Return the anchors that are more likely at fault than not, each with its fault."""
    return at_fault(state.lateration.fault_log_odds, heard, FAULTS)


def fault_of_heard(
    out: Mapping[str, Fault | None], levels: LocalLevels, site: SiteModel
) -> FloatArray:
    """Return the probability (anchors,) that each anchor heard is at fault: those left out are.

    Suspicion short of that changes nothing. If it did, the place would turn from the suspect's
    level to fit the others, which makes the suspect fit worse: doubt would feed itself.
    """
    is_out = [site.anchors[i].anchor_id in out for i in levels.anchor_index]
    return np.where(is_out, LEFT_OUT_FAULT, USUAL_FAULT)


def doubt(
    state: SessionState,
    scan: tuple[Window, LocalLevels, LevelModel, float],
    elapsed_s: float,
    where: tuple[SiteModel, int],
    params: Params,
) -> SessionState:
    """Judge the anchors by a scan, from the place that the filter now holds.

    Parameters
    ----------
    scan
        The readings and their means, the anchors' models, and how many independent scans' worth
        this one is.
    elapsed_s
        Since the scan before.
    where
        The site, and the floor's index.
    """
    if state.track is None or state.floor_belief is None:
        return state
    evidence: dict[str, list[float]] = {}
    if state.floor_belief.max() >= SURE_OF_FLOOR:
        new = min(elapsed_s / params.lateration.window_s, NEW_AT_MOST)
        offset = state.lateration.offset or PhoneOffset(0.0, params.lateration.offset_prior_db)
        points = _points(*place_of(state.track), params)
        evidence = _evidence((points, offset), scan, new, where)
    odds = judged(state.lateration.fault_log_odds, evidence, elapsed_s, FAULTS)
    return changed(state, lateration=replace(state.lateration, fault_log_odds=odds))


def _evidence(
    phone: tuple[FloatArray, PhoneOffset],
    scan: tuple[Window, LocalLevels, LevelModel, float],
    new: float,
    where: tuple[SiteModel, int],
) -> dict[str, list[float]]:
    """Return what the scan says of each anchor, by its id.

    Parameters
    ----------
    phone
        Where it may be (see `_points`), and its level offset.
    new
        The share of the scan that is.
    """
    (points, offset), (window, levels, model, worth), (site, _) = phone, scan, where
    loss_db = [wall_loss_db(site, int(i)) for i in levels.anchor_index]
    residual_db = residuals_at(levels, model, loss_db, points) - offset.mean_db
    sigma_db = _sigma_db(model, levels.anchor_index, points[0], offset)
    # Where most fit badly the place is wrong.
    scatter_db = ROBUST_SIGMA * float(np.median(np.abs(residual_db[0])))
    sigma_db = np.maximum(sigma_db, scatter_db)
    found = heard_evidence(residual_db, POINT_WEIGHT, sigma_db, FAULTS)
    found *= min(NEWS_GAIN * worth, new)
    # Fading changes faster than shadowing: each new reading is news.
    found[:, DUPLICATED] += new * two_levels(window, len(levels.anchor_index))
    silent, told = _silent(levels, model, where, points, offset, scatter_db)
    ids = [site.anchors[i].anchor_id for i in (*levels.anchor_index, *silent)]
    return dict(zip(ids, [*found.tolist(), *(new * told).tolist()], strict=True))


def _points(place: FloatArray, covariance: FloatArray, params: Params) -> FloatArray:
    """Return where the phone may be, (points, 2), the filter's place first."""
    report = params.report
    spread = report.laterated_scale * covariance + report.laterated_extra_m2 * np.eye(2)
    # The symmetric root, not Cholesky's: a plan that is turned turns the points with it.
    det_root = math.sqrt(np.linalg.det(spread))
    root = (spread + det_root * np.eye(2)) / math.sqrt(np.trace(spread) + 2.0 * det_root)
    return np.asarray(place + POINT_SIGMAS @ root)


def _sigma_db(
    model: LevelModel, which: IntArray, place: FloatArray, offset: PhoneOffset
) -> FloatArray:
    """Return how far each of some levels may be from the model's at the right place."""
    heard = model.table[which]
    dx, dy = (place - heard[:, :2]).T
    squared_m2 = np.maximum(dx * dx + dy * dy + heard[:, DZ2], HEIGHT_M**2)
    higher_m2 = HEIGHT_M * (HEIGHT_M + 2.0 * np.sqrt(heard[:, DZ2]))
    height_db = 0.5 * heard[:, SLOPE] * np.log1p(higher_m2 / squared_m2)
    hand_db = max(OFFSET_SIGMA_DB, offset.sigma_db)
    return np.asarray(np.sqrt(heard[:, SIGMA] ** 2 + height_db**2 + hand_db**2))


def _silent(
    levels: LocalLevels,
    model: LevelModel,
    where: tuple[SiteModel, int],
    points: FloatArray,
    offset: PhoneOffset,
    scatter_db: float,
) -> tuple[IntArray, FloatArray]:
    """Return the anchors of the floor that are near and not heard, and what that says of each."""
    site, floor = where
    is_unheard = anchor_floors(site) == floor
    is_unheard[levels.anchor_index] = False
    unheard = np.flatnonzero(is_unheard)
    near = unheard[np.hypot(*(model.table[unheard, :2] - points[0]).T) < NEAR_M]
    if not len(near):
        return near, np.empty((0, len(Fault)))
    count = len(near)
    nothing = LocalLevels(
        near, np.zeros(count), np.ones(count), np.zeros(count), np.zeros((count, 2))
    )
    loss_db = [wall_loss_db(site, int(i)) for i in near]
    expected_dbm = offset.mean_db - residuals_at(nothing, model, loss_db, points)
    above_db = expected_dbm - levels.level_dbm.min()
    sigma_db = np.maximum(_sigma_db(model, near, points[0], offset), scatter_db)
    return near, silent_evidence(above_db, POINT_WEIGHT, sigma_db, FAULTS)
