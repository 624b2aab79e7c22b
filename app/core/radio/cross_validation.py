"""Cross-validation of a calibration: what it is worth at places that it has not seen.

Equation
--------
The places are cut into square cells, and the cells dealt to folds so that neighbours are in
different ones. Every fold's levels are predicted by the calibration of the other folds, once with
the anchor's own model and once with the floor's mean one. Over the cells c of anchor i that were
left out, with ``q_c`` the mean of the squared residuals in cell c::

    gain_i = mean_c (q_c(mean) - q_c(own)),    sigma_i = sd_c (q_c(mean) - q_c(own)) / sqrt(C)

An anchor whose gain is not larger than its own standard error keeps the floor's mean: its
deviation from the others is not more than what shadowing at a few places makes of it.

Levels at neighbouring places share their shadowing (Gudmundson 1991), so whole cells are left out,
never single levels. Levels of one walk share the body that carried the phone and what stood about
that day, so where levels come from several walks whole walks are left out (`folds_by_walk`). The
bound of one standard error is that of Breiman et al., "Classification and
Regression Trees", 1984: the simpler model unless the other is clearly better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.radio.calibration import (
    Calibration,
    CalibrationParams,
    LabelledLevels,
    calibrate,
    residuals_db,
)
from app.core.types import Anchor, BoolArray, FloatArray, IntArray

FOLDS = 5
"""Four fifths of the places calibrate nearly as well as all of them."""

CELL_M = 3.0
"""Shadowing indoors stays alike over some metres: what is nearer is the same place."""

MIN_CELLS = 6
"""Cells from which a standard error can be told."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Residuals of levels at places that were left out.

    Attributes
    ----------
    own_db, mean_db : (readings,)
        Level less its prediction by the anchor's own model, and by the floor's mean one; nan where
        the other folds cannot be calibrated.
    gain_db2, gain_sigma_db2 : (anchors,)
        What the own model takes off the squared residual, and its standard error; nan where fewer
        than `MIN_CELLS` cells tell.
    """

    own_db: FloatArray
    mean_db: FloatArray
    gain_db2: FloatArray
    gain_sigma_db2: FloatArray

    @property
    def is_own_better(self) -> BoolArray:
        """Which anchors (anchors,) are clearly better described by a model of their own."""
        return np.nan_to_num(self.gain_db2 - self.gain_sigma_db2, nan=-1.0) > 0.0


def folds_by_place(x_m: FloatArray, y_m: FloatArray, folds: int = FOLDS) -> IntArray:
    """Return the fold of each place; neighbouring cells are in different folds."""
    column, row = _cells(x_m, y_m)
    return np.asarray((column + 2 * row) % folds)


def folds_by_walk(walks: Sequence[str], folds: int = FOLDS) -> IntArray:
    """Return the fold of each walk's levels, by the name of their walk."""
    number = {walk: i for i, walk in enumerate(sorted(set(walks)))}
    return np.array([number[walk] % folds for walk in walks], dtype=np.int64)


def cross_validate(
    levels: LabelledLevels,
    anchors: Sequence[Anchor],
    params: CalibrationParams,
    fold: IntArray | None = None,
) -> CrossValidation:
    """Return how well levels are predicted that were left out.

    Parameters
    ----------
    levels, anchors, params
        As for `app.core.radio.calibration.calibrate`.
    fold : (readings,)
        Which levels are left out together; None: `folds_by_place`.
    """
    own_db, mean_db = np.full(len(levels.x_m), np.nan), np.full(len(levels.x_m), np.nan)
    if fold is None:
        fold = folds_by_place(levels.x_m, levels.y_m)
    for left_out, fit in fits_without(levels, fold, anchors, params):
        asked = levels.of(left_out)
        own_db[left_out] = residuals_db(asked, anchors, fit, params)
        mean_db[left_out] = residuals_db(asked, anchors, at_the_mean(fit), params)
    gain_db2, gain_sigma_db2 = _gains(levels, mean_db**2 - own_db**2, len(anchors))
    return CrossValidation(own_db, mean_db, gain_db2, gain_sigma_db2)


def fits_without(
    levels: LabelledLevels, fold: IntArray, anchors: Sequence[Anchor], params: CalibrationParams
) -> Iterator[tuple[BoolArray, Calibration]]:
    """Yield the levels (readings,) of each fold, and the calibration of all others.

    Folds without which nothing can be calibrated are passed over.
    """
    phones = int(levels.phone_index.max()) + 1
    for k in np.unique(fold):
        left_out = fold == k
        try:
            fit = calibrate(levels.of(~left_out), anchors, params)
        except ValueError:
            continue
        unheard = np.zeros(phones - len(fit.offset_db))
        yield left_out, replace(fit, offset_db=np.concatenate([fit.offset_db, unheard]))


def careful(
    levels: LabelledLevels,
    anchors: Sequence[Anchor],
    params: CalibrationParams,
    proof: tuple[LabelledLevels, IntArray] | None = None,
) -> tuple[Calibration, CrossValidation]:
    """Calibrate, and leave at the floor's mean whom a model of its own does not clearly serve.

    Parameters
    ----------
    levels, anchors, params
        As for `app.core.radio.calibration.calibrate`.
    proof
        The same levels as they are to be cross-validated, and their folds: where several walks
        heard a beacon at one place, that is one of the ``levels``, but one for each walk here.
        None: ``levels`` by place.

    Raises
    ------
    ValueError
        If the readings cannot tell level from slope.
    """
    fit = calibrate(levels, anchors, params)
    asked, fold = (levels, None) if proof is None else proof
    checked = cross_validate(asked, anchors, params, fold)
    return held_to_mean(fit, ~checked.is_own_better, levels, anchors, params), checked


def at_the_mean(fit: Calibration) -> Calibration:
    """Return the calibration with the floor's mean model for every anchor."""
    everyone = np.ones(len(fit.ref_level_dbm))
    return replace(
        fit,
        ref_level_dbm=fit.mean_ref_level_dbm * everyone,
        path_loss_exponent=fit.mean_exponent * everyone,
    )


def held_to_mean(
    fit: Calibration,
    held: BoolArray,
    levels: LabelledLevels,
    anchors: Sequence[Anchor],
    params: CalibrationParams,
) -> Calibration:
    """Return the calibration with the floor's mean for the anchors held (anchors,) to it."""
    mixed = replace(
        fit,
        ref_level_dbm=np.where(held, fit.mean_ref_level_dbm, fit.ref_level_dbm),
        path_loss_exponent=np.where(held, fit.mean_exponent, fit.path_loss_exponent),
    )
    left_db = residuals_db(levels, anchors, mixed, params)
    residual_db = float(np.sqrt(np.mean(left_db**2)))
    own = np.bincount(levels.anchor_index, left_db**2, len(anchors))
    squares = own + params.noise_weight * residual_db**2
    shadowing_db = np.sqrt(squares / (fit.readings + params.noise_weight))
    return replace(mixed, shadowing_db=shadowing_db, residual_db=residual_db)


def _cells(x_m: FloatArray, y_m: FloatArray) -> tuple[IntArray, IntArray]:
    return np.floor(x_m / CELL_M).astype(np.int64), np.floor(y_m / CELL_M).astype(np.int64)


def _gains(
    levels: LabelledLevels, gain_db2: FloatArray, anchors: int
) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard error (anchors,) of the gain over cells."""
    column, row = _cells(levels.x_m, levels.y_m)
    known = ~np.isnan(gain_db2)
    keys = np.column_stack([levels.anchor_index, column, row])[known]
    cells, group, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    of_cell = np.bincount(group.reshape(-1), gain_db2[known], len(cells)) / count
    mean, sigma = np.full(anchors, np.nan), np.full(anchors, np.nan)
    for i in range(anchors):
        own = of_cell[cells[:, 0] == i]
        if len(own) >= MIN_CELLS:
            mean[i], sigma[i] = own.mean(), own.std(ddof=1) / np.sqrt(len(own))
    return mean, sigma
