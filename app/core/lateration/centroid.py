"""Weighted centroid: the mean place of the loudest anchors, louder ones counting more.

Equation
--------
``p = sum w_i p_i / sum w_i`` over the ``strongest`` anchors, ``w_i = 10^(u_i / (10 g))``, ``u_i``
the mean level of anchor i in the window: with ``g`` the path-loss exponent of the surroundings the
weight is one over the distance, with half of it one over its square. Nothing is calibrated, so all
anchors must send alike.

The covariance is isotropic, ``(tr S / 2 + s0^2) I``, ``S`` the weighted scatter of the anchors that
count: a phone may be as far from their centroid as they are, to every side; anchors in a row say
nothing of the side.

Source: Blumenthal et al., "Weighted centroid localization in Zigbee-based sensor networks", IEEE
International Symposium on Intelligent Signal Processing, 2007.
"""

from dataclasses import dataclass

import numpy as np

from app.core.radio.path_loss import LevelModel, X, Y
from app.core.radio.windows import Window
from app.core.types import Fix, Method, NoFix, NoFixReason, Used


@dataclass(frozen=True, slots=True)
class CentroidParams:
    """Parameters of the weighted centroid.

    Attributes
    ----------
    strongest
        Anchors that count: the ones around the phone; farther ones only pull to the middle.
    weight_exponent
        ``g`` above; 1 weighs by one over the square of the distance indoors, which is best on real
        scans (uji_ble: 2.66 m, against 2.80 with 2).
    min_anchors
        Fewer anchors heard are no fix.
    least_sigma_m
        ``s0``: a phone is not at the very place of an anchor.
    """

    strongest: int = 6
    weight_exponent: float = 1.0
    min_anchors: int = 3
    least_sigma_m: float = 1.0


def weighted_centroid(
    window: Window, model: LevelModel, at_s: float, params: CentroidParams
) -> Fix | NoFix:
    """Return the weighted centroid of the anchors heard in a window.

    ``window.anchor_index`` points into ``model``, of which only the places count.
    """
    if not len(window):
        return NoFix(at_s, NoFixReason.NOTHING_HEARD)
    count = np.bincount(window.anchor_index)
    which = np.flatnonzero(count)
    if len(which) < params.min_anchors:
        return NoFix(at_s, NoFixReason.TOO_FEW_TRANSMITTERS)
    level_dbm = np.bincount(window.anchor_index, window.rssi_dbm)[which] / count[which]
    loudest = np.argsort(-level_dbm, kind="stable")[: params.strongest]
    weight = 10.0 ** ((level_dbm[loudest] - level_dbm.max()) / (10.0 * params.weight_exponent))
    weight /= weight.sum()
    places = model.table[which[loudest], X : Y + 1]
    centroid = weight @ places
    scatter_m2 = float(weight @ ((places - centroid) ** 2).sum(axis=1))
    variance_m2 = 0.5 * scatter_m2 + params.least_sigma_m**2
    return Fix(
        time_s=at_s,
        x_m=float(centroid[0]),
        y_m=float(centroid[1]),
        covariance_m2=(variance_m2, 0.0, variance_m2),
        method=Method.LATERATION,
        used=Used(beacons=len(which)),
    )
