"""What data sets with known beacons share: calibration, and one row of figures per method."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.lateration.posterior import PhoneOffset, PlacePrior, local_levels, place_posterior
from app.core.lateration.surface import box_around, corners_around
from app.core.params import LaterationParams, MatchParams
from app.core.radio.beacon_places import BeaconPlacesParams, beacon_places
from app.core.radio.calibration import (
    Calibration,
    CalibrationParams,
    LabelledLevels,
    calibrate,
    calibrated,
    residuals_db,
)
from app.core.radio.cross_validation import at_the_mean, careful
from app.core.radio.path_loss import LevelModel, X, Y, level_model
from app.core.radio.wall_losses import NO_LOSS, loss_map_db, wall_losses_db
from app.core.radio.windows import Window
from app.core.site import Wall
from app.core.types import Anchor, FloatArray

Place = tuple[float, float]

MIN_ANCHORS = 3

LATERATION = LaterationParams(
    offset_prior_db=2.0, shadowing_correlation=1.0, search_margin_m=2.0, min_anchors=MIN_ANCHORS
)
"""Phones of the model that was calibrated with (a small offset is left), among all of a site's
anchors."""

UNKNOWN_PHONE = replace(LATERATION, offset_prior_db=10.0)
"""The same for a phone that was never calibrated."""

CHI2_95 = 5.99
"""A point of two dimensions is within this (squared, normalised) in 95 of 100 cases."""

ATTENUATIONS_DB = tuple(0.5 * step for step in range(13))
"""What a wall, or one side of a piece of furniture, may take: nothing to 6 dB (a brick wall)."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Anchors and walls as they fit best: the level models, and what the walls take from each."""

    anchors: tuple[Anchor, ...]
    walls: tuple[Wall, ...]
    model: LevelModel
    loss_db: tuple[FloatArray, ...]


def surveyed(
    anchors: Sequence[Anchor],
    heard: FloatArray,
    walls: Sequence[Wall] = (),
    phone_height_m: float = 0.0,
) -> Surroundings:
    """Calibrate anchors, and what a wall takes, with readings of one phone.

    Parameters
    ----------
    heard : (n, 4)
        Anchor, x, y and level of each reading.
    walls
        Where walls are; their attenuation is the one that leaves the least residuals.
    """
    faces = np.array([(w.x0_m, w.y0_m, w.x1_m, w.y1_m, 1.0) for w in walls]).reshape(-1, 5)
    params = CalibrationParams(phone_height_m=phone_height_m)
    tried = [
        (fit.residual_db, attenuation_db, fit)
        for attenuation_db in (ATTENUATIONS_DB if walls else (0.0,))
        for fit in (_calibration(anchors, heard, faces * (1, 1, 1, 1, attenuation_db), params),)
    ]
    _, attenuation_db, fit = min(tried, key=itemgetter(0))
    known = calibrated(anchors, fit)
    faces[:, 4] = attenuation_db
    return Surroundings(
        anchors=known,
        walls=tuple(replace(wall, attenuation_db=attenuation_db) for wall in walls),
        model=level_model(known, phone_height_m),
        loss_db=tuple(loss_map_db(faces, (anchor.x_m, anchor.y_m)) for anchor in known),
    )


def _calibration(
    anchors: Sequence[Anchor], heard: FloatArray, walls: FloatArray, params: CalibrationParams
) -> Calibration:
    """Return the calibration with the levels that would be heard without the walls."""
    index = heard[:, 0].astype(np.int64)
    unobstructed_dbm = heard[:, 3].copy()
    for i, anchor in enumerate(anchors):
        own = index == i
        place_m = (anchor.x_m, anchor.y_m)
        unobstructed_dbm[own] += wall_losses_db(walls, place_m, heard[own, 1], heard[own, 2])
    levels = LabelledLevels(index, np.zeros_like(index), heard[:, 1], heard[:, 2], unobstructed_dbm)
    return calibrate(levels, anchors, params)


def carefully_surveyed(anchors: Sequence[Anchor], heard: FloatArray) -> Surroundings:
    """Calibrate as the server does, without walls: as `surveyed`, checked at places left out."""
    levels, params = _of_one_phone(heard), CalibrationParams()
    return _in_the_open(calibrated(anchors, careful(levels, anchors, params)[0]))


def ratios_to_mean(anchors: Sequence[Anchor], heard: FloatArray, asked: FloatArray) -> list[float]:
    """Return each anchor's residual at other places, as a ratio to that of the floor's mean model.

    Parameters
    ----------
    heard, asked : (n, 4)
        Anchor, x, y and level of the readings to calibrate with, and of those to ask.
    """
    params, levels = CalibrationParams(), _of_one_phone(asked)
    fit, _ = careful(_of_one_phone(heard), anchors, params)
    squares = [
        np.bincount(
            levels.anchor_index, residuals_db(levels, anchors, which, params) ** 2, len(anchors)
        )
        for which in (fit, at_the_mean(fit))
    ]
    is_asked = squares[1] > 0.0
    ratios: list[float] = np.sqrt(squares[0][is_asked] / squares[1][is_asked]).tolist()
    return ratios


@dataclass(frozen=True, slots=True)
class PlaceError:
    """How far an estimated place is from the true one, and whether that was told (95 %)."""

    error_m: float
    is_inside95: bool


def placed(
    anchors: Sequence[Anchor], heard: FloatArray, z_m: float, params: BeaconPlacesParams
) -> tuple[Surroundings, list[PlaceError]]:
    """Return anchors at estimated places, as if theirs were not known, and how wrong these are."""
    found = beacon_places(_of_one_phone(heard), len(anchors), params)
    estimated, errors = [], []
    for i, anchor in enumerate(anchors):
        if np.isnan(found.x_m[i]):
            continue
        x_m, y_m = float(found.x_m[i]), float(found.y_m[i])
        off = np.array([x_m - anchor.x_m, y_m - anchor.y_m])
        distance2 = float(off @ np.linalg.solve(found.covariance_m2[i], off))
        errors.append(PlaceError(float(np.hypot(*off)), distance2 <= CHI2_95))
        model = (found.ref_level_dbm[i], found.path_loss_exponent[i], found.shadowing_db[i])
        level_dbm, exponent, shadowing_db = map(float, model)
        estimated.append(
            replace(
                anchor,
                x_m=x_m,
                y_m=y_m,
                z_m=z_m,
                ref_level_dbm=level_dbm,
                path_loss_exponent=exponent,
                shadowing_db=shadowing_db,
            )
        )
    return _in_the_open(tuple(estimated), z_m - params.height_m), errors


def _in_the_open(anchors: tuple[Anchor, ...], phone_height_m: float = 0.0) -> Surroundings:
    model = level_model(anchors, phone_height_m)
    return Surroundings(anchors, (), model, (NO_LOSS,) * len(anchors))


def _of_one_phone(heard: FloatArray) -> LabelledLevels:
    index = heard[:, 0].astype(np.int64)
    return LabelledLevels(index, np.zeros_like(index), heard[:, 1], heard[:, 2], heard[:, 3])


def laterated(window: Window, among: Surroundings, params: LaterationParams) -> Place | None:
    """Return the mean place among all of the anchors; None if too few of them are heard."""
    if window.anchors_heard < params.min_anchors:
        return None
    levels = local_levels(window, among.model, params.shadowing_correlation)
    places = among.model.table[:, X : Y + 1]
    found = place_posterior(
        levels,
        among.model,
        [among.loss_db[i] for i in levels.anchor_index],
        PhoneOffset(0.0, params.offset_prior_db),
        PlacePrior(box_around(corners_around(places), params.search_margin_m)),
    )
    return float(found.mean[0]), float(found.mean[1])


def matched(levels_dbm: dict[str, float], radio_map: RadioMap, params: MatchParams) -> Place | None:
    """Return the weighted mean of the nearest fingerprints; None if nothing is known."""
    matches = match(Query({}, levels_dbm), radio_map, params)
    if matches is None:
        return None
    return float(matches.weight @ matches.x_m), float(matches.weight @ matches.y_m)
