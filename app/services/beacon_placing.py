"""Places and level models of beacons that nobody measured, from labelled epochs of a floor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.core.radio.beacon_places import BeaconPlaces, BeaconPlacesParams, beacon_places
from app.core.radio.calibration import LabelledLevels
from app.core.types import FloatArray
from app.services.beacon_calibration import LevelModelFields
from app.services.labelled_epochs import LabelledEpoch, labelled_levels

TOO_FEW_LEVELS = "too_few_levels"
WIDE = "wide"
AT_THE_EDGE = "at_the_edge"

FEW_LEVELS = 6
"""Places at which a beacon must have been heard: a plane, a level and a slope are four numbers."""

WIDE_SIGMA_M = 5.0
"""A beacon known worse than this tells a phone less than the fingerprints around it do."""


@dataclass(frozen=True, slots=True)
class PlacedBeacon:
    """Where one beacon is believed to be.

    Attributes
    ----------
    levels
        Places at which it was heard.
    x_m, y_m, covariance_m2
        Of the place, the latter ``(xx, xy, yy)``; None where the levels are too few.
    warnings
        `TOO_FEW_LEVELS`, `WIDE` (its worst standard deviation is above `WIDE_SIGMA_M`),
        `AT_THE_EDGE` (it was heard from one side only: it lies outside all places of the survey).
    """

    beacon_id: str
    levels: int
    x_m: float | None
    y_m: float | None
    covariance_m2: tuple[float, float, float] | None
    model: LevelModelFields | None
    warnings: tuple[str, ...] = ()


def place_beacons(
    epochs: Sequence[LabelledEpoch],
    beacon_ids: Sequence[str],
    params: BeaconPlacesParams | None = None,
) -> tuple[PlacedBeacon, ...]:
    """Return where beacons are that these epochs heard.

    Parameters
    ----------
    epochs
        On one floor.
    beacon_ids
        Of whom to tell; others in the epochs are passed over.
    """
    phones = sorted({epoch.device_id for epoch in epochs})
    levels = labelled_levels(epochs, beacon_ids, phones)
    found = beacon_places(levels, len(beacon_ids), params or BeaconPlacesParams())
    area = _area(levels)
    return tuple(_placed(found, i, beacon_id, area) for i, beacon_id in enumerate(beacon_ids))


def _area(levels: LabelledLevels) -> FloatArray:
    """Return left, low, right, high of the places of the levels; nothing is inside without any."""
    if not len(levels.x_m):
        return np.array([np.inf, np.inf, -np.inf, -np.inf])
    x_m, y_m = levels.x_m, levels.y_m
    return np.array([x_m.min(), y_m.min(), x_m.max(), y_m.max()])


def _placed(found: BeaconPlaces, i: int, beacon_id: str, area: FloatArray) -> PlacedBeacon:
    levels, x_m, y_m = int(found.levels[i]), float(found.x_m[i]), float(found.y_m[i])
    if levels < FEW_LEVELS:
        return PlacedBeacon(beacon_id, levels, None, None, None, None, (TOO_FEW_LEVELS,))
    covariance = found.covariance_m2[i]
    model = LevelModelFields(
        float(found.ref_level_dbm[i]),
        float(found.path_loss_exponent[i]),
        float(found.shadowing_db[i]),
    )
    is_inside = area[0] <= x_m <= area[2] and area[1] <= y_m <= area[3]
    doubts = {
        WIDE: float(np.linalg.eigvalsh(covariance)[-1]) > WIDE_SIGMA_M**2,
        AT_THE_EDGE: not is_inside,
    }
    warnings = tuple(name for name, is_so in doubts.items() if is_so)
    xx, xy, yy = (float(covariance[row, column]) for row, column in ((0, 0), (0, 1), (1, 1)))
    return PlacedBeacon(beacon_id, levels, x_m, y_m, (xx, xy, yy), model, warnings)
