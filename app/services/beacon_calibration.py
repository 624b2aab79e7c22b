"""Calibration of a floor's beacons: their level models and phones' offsets, from labelled epochs.

The positioning error before and after is cross-validated: every fifth of the walks, or of the
places where the levels are not of several walks, is located with what the other four fifths
calibrate, and never with itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.radio.calibration import (
    Calibration,
    CalibrationParams,
    LabelledLevels,
    calibrated,
    joined_levels,
    residuals_db,
)
from app.core.radio.cross_validation import (
    CrossValidation,
    careful,
    folds_by_place,
    folds_by_walk,
)
from app.core.radio.path_loss import level_model
from app.core.radio.wall_losses import loss_map_db, wall_losses_db
from app.core.radio.windows import window_of
from app.core.site import Wall
from app.core.types import Anchor, BoolArray, FloatArray, IntArray
from app.services.errors import AppError, ErrorCode
from app.services.evaluation.beacons import MIN_ANCHORS, UNKNOWN_PHONE, Surroundings, laterated
from app.services.labelled_epochs import LabelledEpoch, labelled_levels

MIN_LEVELS = 30
"""Levels in all: with fewer, five folds cannot tell better from worse."""

DETERMINED_SHARE = 0.5
"""An anchor's number of which its own readings tell less is more the floor's mean than its own."""

WALKS, PLACES = "walks", "places"

NEVER_HEARD = "never_heard"
LEVEL_FROM_MEAN = "level_from_mean"
EXPONENT_FROM_MEAN = "exponent_from_mean"
NO_BETTER_THAN_MEAN = "no_better_than_mean"
EXPONENT_AT_BOUND = "exponent_at_bound"


@dataclass(frozen=True, slots=True)
class LevelModelFields:
    """A beacon's level model, at its own calibration distance."""

    ref_level_dbm: float
    path_loss_exponent: float
    shadowing_db: float


@dataclass(frozen=True, slots=True)
class CalibratedBeacon:
    """What was found of one beacon.

    Attributes
    ----------
    levels
        Places (of one phone each) at which it was heard.
    before_residual_db, after_residual_db
        Root mean square of level less expectation, of the registered model and, cross-validated as
        the errors are, of calibrated ones; None where it was not heard.
    warnings
        What the levels could not tell; see docs/calibration.md.
    """

    beacon_id: str
    levels: int
    before: LevelModelFields
    after: LevelModelFields
    before_residual_db: float | None
    after_residual_db: float | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CalibratedPhone:
    """How much more a phone hears than all phones' mean."""

    device_id: str
    levels: int
    offset_db: float


@dataclass(frozen=True, slots=True)
class PositionError:
    """Error of lateration over epochs with enough beacons; None without one."""

    samples: int
    mean_error_m: float | None
    median_error_m: float | None
    p95_error_m: float | None


@dataclass(frozen=True, slots=True)
class FloorCalibration:
    """What labelled epochs tell of a floor.

    ``left_out`` says what was left out at once in cross-validation: `WALKS` or `PLACES`.
    """

    beacons: tuple[CalibratedBeacon, ...]
    phones: tuple[CalibratedPhone, ...]
    mean_ref_level_dbm: float
    mean_exponent: float
    residual_db: float
    before: PositionError
    after: PositionError
    left_out: str


def calibrate_floor(
    epochs: Sequence[LabelledEpoch],
    anchors: Sequence[Anchor],
    walls: Sequence[Wall] = (),
    params: CalibrationParams | None = None,
) -> FloorCalibration:
    """Calibrate a floor's anchors.

    Parameters
    ----------
    epochs
        On this floor; beacons by ``anchor_id``.
    walls
        What each takes is taken for known.

    Raises
    ------
    AppError
        `INVALID_FIELD` if the levels are too few, or all at one distance.
    """
    work = _Work(epochs, anchors, walls, params or CalibrationParams())
    return work.report()


@dataclass(frozen=True, slots=True, eq=False)
class _LeftOut:
    """Levels of one fold less what the other folds expect, (readings,) each."""

    anchor_index: IntArray
    residual_db: FloatArray


class _Work:
    """One calibration's arrays, made once."""

    def __init__(
        self,
        epochs: Sequence[LabelledEpoch],
        anchors: Sequence[Anchor],
        walls: Sequence[Wall],
        params: CalibrationParams,
    ) -> None:
        self._epochs, self._anchors, self._params = epochs, tuple(anchors), params
        self._phones = sorted({epoch.device_id for epoch in epochs})
        self._faces = np.array(
            [(w.x0_m, w.y0_m, w.x1_m, w.y1_m, w.attenuation_db) for w in walls]
        ).reshape(-1, 5)
        self._ids = [anchor.anchor_id for anchor in anchors]
        self._levels = self._heard_in(epochs)
        if len(self._levels.x_m) < MIN_LEVELS:
            detail = (
                f"{len(self._levels.x_m)} levels of this floor's beacons at known places (each "
                f"counts once per place of 1 m); at least {MIN_LEVELS} are needed"
            )
            raise AppError(ErrorCode.INVALID_FIELD, detail)
        self._losses = tuple(loss_map_db(self._faces, (a.x_m, a.y_m)) for a in self._anchors)
        self._index = {anchor_id: i for i, anchor_id in enumerate(self._ids)}

    def report(self) -> FloorCalibration:
        """Fit all, check by folds, and tell."""
        try:
            fit, checked = self._fit(self._epochs)
        except ValueError as error:
            raise AppError(ErrorCode.INVALID_FIELD, str(error)) from error
        left_out, after_m = self._left_out()
        before_m = self._errors_m(self._anchors, np.zeros(len(self._phones)), self._all_epochs())
        both = ~np.isnan(after_m) & ~np.isnan(before_m)
        return FloorCalibration(
            beacons=self._beacons(fit, checked.is_own_better, left_out),
            phones=self._told_phones(fit),
            mean_ref_level_dbm=fit.mean_ref_level_dbm,
            mean_exponent=fit.mean_exponent,
            residual_db=fit.residual_db,
            before=_position_error(before_m[both]),
            after=_position_error(after_m[both]),
            left_out=WALKS if _are_of_walks(self._epochs) else PLACES,
        )

    def _heard_in(self, epochs: Sequence[LabelledEpoch]) -> LabelledLevels:
        """Return the levels of some epochs, as they would be heard without the walls."""
        heard = labelled_levels(epochs, self._ids, self._phones)
        rssi_dbm = heard.rssi_dbm.copy()
        for i, anchor in enumerate(self._anchors):
            own = heard.anchor_index == i
            place_m = (anchor.x_m, anchor.y_m)
            rssi_dbm[own] += wall_losses_db(self._faces, place_m, heard.x_m[own], heard.y_m[own])
        return replace(heard, rssi_dbm=rssi_dbm)

    def _fit(self, epochs: Sequence[LabelledEpoch]) -> tuple[Calibration, CrossValidation]:
        proof = self._by_walk(epochs) if _are_of_walks(epochs) else None
        return careful(self._heard_in(epochs), self._anchors, self._params, proof)

    def _by_walk(self, epochs: Sequence[LabelledEpoch]) -> tuple[LabelledLevels, IntArray]:
        """Return levels each of which is of one walk, and their folds."""
        walks = sorted({epoch.walk for epoch in epochs})
        heard = [self._heard_in([e for e in epochs if e.walk == walk]) for walk in walks]
        names = [name for name, own in zip(walks, heard, strict=True) for _ in own.x_m]
        return joined_levels(heard), folds_by_walk(names)

    def _left_out(self) -> tuple[list[_LeftOut], FloatArray]:
        """Return residuals and errors (epochs,) of what the other folds calibrate."""
        fold = _folds_of(self._epochs)
        told: list[_LeftOut] = []
        errors_m = np.full(len(self._epochs), np.nan)
        for k in np.unique(fold):
            here = np.flatnonzero(fold == k)
            others = np.flatnonzero(fold != k).tolist()
            try:
                fit, _ = self._fit([self._epochs[i] for i in others])
            except ValueError:
                continue
            unheard = np.zeros(len(self._phones) - len(fit.offset_db))
            fit = replace(fit, offset_db=np.concatenate([fit.offset_db, unheard]))
            asked = self._heard_in([self._epochs[i] for i in here.tolist()])
            residual_db = residuals_db(asked, self._anchors, fit, self._params)
            told.append(_LeftOut(asked.anchor_index, residual_db))
            anchors = calibrated(self._anchors, fit)
            errors_m[here] = self._errors_m(anchors, fit.offset_db, here)[here]
        return told, errors_m

    def _all_epochs(self) -> IntArray:
        return np.arange(len(self._epochs))

    def _errors_m(
        self, anchors: Sequence[Anchor], offset_db: FloatArray, which: IntArray
    ) -> FloatArray:
        """Return the error (epochs,) of lateration in some epochs, nan without a place."""
        model = level_model(anchors, self._params.phone_height_m)
        among = Surroundings(tuple(anchors), (), model, self._losses)
        errors_m = np.full(len(self._epochs), np.nan)
        for k in which.tolist():
            epoch = self._epochs[k]
            known = [(self._index[b], u) for b, u in epoch.rssi_dbm.items() if b in self._index]
            if len(known) < MIN_ANCHORS:
                continue
            index, rssi_dbm = np.array(known).T
            rssi_dbm = rssi_dbm - offset_db[self._phones.index(epoch.device_id)]
            window = window_of(index.astype(np.int64), np.zeros(len(index)), rssi_dbm)
            place = laterated(window, among, UNKNOWN_PHONE)
            if place is not None:
                errors_m[k] = float(np.hypot(place[0] - epoch.x_m, place[1] - epoch.y_m))
        return errors_m

    def _beacons(
        self, fit: Calibration, is_own_better: BoolArray, left_out: Sequence[_LeftOut]
    ) -> tuple[CalibratedBeacon, ...]:
        registered = replace(
            fit,
            ref_level_dbm=np.array([a.ref_level_dbm for a in self._anchors]),
            path_loss_exponent=np.array([a.path_loss_exponent for a in self._anchors]),
            offset_db=np.zeros(len(self._phones)),
        )
        before_db = residuals_db(self._levels, self._anchors, registered, self._params)
        told = []
        for i, anchor in enumerate(self._anchors):
            own = self._levels.anchor_index == i
            after = LevelModelFields(
                float(fit.ref_level_dbm[i]),
                float(fit.path_loss_exponent[i]),
                float(fit.shadowing_db[i]),
            )
            told.append(
                CalibratedBeacon(
                    anchor.anchor_id,
                    int(fit.readings[i]),
                    LevelModelFields(
                        anchor.ref_level_dbm, anchor.path_loss_exponent, anchor.shadowing_db
                    ),
                    after,
                    _root_mean_square(before_db[own]),
                    _root_mean_square(_residuals_of(left_out, i)),
                    _warnings(fit, i, self._params, is_own_better=bool(is_own_better[i])),
                )
            )
        return tuple(told)

    def _told_phones(self, fit: Calibration) -> tuple[CalibratedPhone, ...]:
        count = np.bincount(self._levels.phone_index, minlength=len(self._phones))
        return tuple(
            CalibratedPhone(device_id, int(count[p]), float(fit.offset_db[p]))
            for p, device_id in enumerate(self._phones)
            if count[p]
        )


def _are_of_walks(epochs: Sequence[LabelledEpoch]) -> bool:
    """Tell whether there are whole walks to leave out: two at least, and nothing else."""
    walks = {epoch.walk for epoch in epochs}
    return len(walks) > 1 and "" not in walks


def _folds_of(epochs: Sequence[LabelledEpoch]) -> IntArray:
    if _are_of_walks(epochs):
        return folds_by_walk([epoch.walk for epoch in epochs])
    return folds_by_place(np.array([e.x_m for e in epochs]), np.array([e.y_m for e in epochs]))


def _residuals_of(left_out: Sequence[_LeftOut], i: int) -> FloatArray:
    own = [fold.residual_db[fold.anchor_index == i] for fold in left_out]
    return np.concatenate([*own, np.empty(0)])


def _warnings(
    fit: Calibration, i: int, params: CalibrationParams, *, is_own_better: bool
) -> tuple[str, ...]:
    if fit.readings[i] == 0:
        return (NEVER_HEARD,)
    if not is_own_better:
        return (NO_BETTER_THAN_MEAN,)
    level_share, exponent_share = fit.determined_share[i]
    at_bound = not params.min_exponent < fit.path_loss_exponent[i] < params.max_exponent
    found = {
        LEVEL_FROM_MEAN: level_share < DETERMINED_SHARE,
        EXPONENT_FROM_MEAN: exponent_share < DETERMINED_SHARE,
        EXPONENT_AT_BOUND: at_bound,
    }
    return tuple(name for name, is_so in found.items() if is_so)


def _root_mean_square(values: FloatArray) -> float | None:
    known = values[~np.isnan(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def _position_error(errors_m: FloatArray) -> PositionError:
    if not len(errors_m):
        return PositionError(0, None, None, None)
    return PositionError(
        len(errors_m),
        float(np.mean(errors_m)),
        float(np.median(errors_m)),
        float(np.percentile(errors_m, 95.0)),
    )
