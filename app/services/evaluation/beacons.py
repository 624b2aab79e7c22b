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
from app.core.radio.calibration import (
    Calibration,
    CalibrationParams,
    LabelledLevels,
    calibrate,
    calibrated,
)
from app.core.radio.path_loss import LevelModel, X, Y, level_model
from app.core.radio.wall_losses import loss_map_db, wall_losses_db
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
