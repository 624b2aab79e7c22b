"""What data sets with known beacons share: calibration, and one row of figures per method."""

from collections.abc import Sequence

import numpy as np

from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import LaterationParams, MatchParams
from app.core.radio.calibration import CalibrationParams, LabelledLevels, calibrate, calibrated
from app.core.types import Anchor, FloatArray

Place = tuple[float, float]

LATERATION = LaterationParams(
    huber_k=3.0, offset_prior_db=2.0, shadowing_correlation=0.5, search_margin_m=2.0
)
"""Calibrated phones among all of a site's anchors: nearly normal residuals, a small offset left."""

UNKNOWN_PHONE = LaterationParams(
    huber_k=3.0, offset_prior_db=10.0, shadowing_correlation=0.5, search_margin_m=2.0
)
"""The same for a phone that was never calibrated."""


def fitted(
    anchors: Sequence[Anchor], heard: FloatArray, params: CalibrationParams
) -> tuple[Anchor, ...]:
    """Return the anchors calibrated with readings (n, 4) of one phone: anchor, x, y and level."""
    anchor = heard[:, 0].astype(np.int64)
    levels = LabelledLevels(anchor, np.zeros_like(anchor), *heard[:, 1:].T)
    return calibrated(anchors, calibrate(levels, anchors, params))


def matched(levels_dbm: dict[str, float], radio_map: RadioMap, params: MatchParams) -> Place | None:
    """Return the weighted mean of the nearest fingerprints; None if nothing is known."""
    matches = match(Query({}, levels_dbm), radio_map, params)
    if matches is None:
        return None
    return float(matches.weight @ matches.x_m), float(matches.weight @ matches.y_m)
