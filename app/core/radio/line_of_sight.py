"""Line of sight from levels: which beacons' ranges may be believed, and whether any at all.

Equation
--------
In a window, beacon i was heard n times with mean level ``m`` and sum of squares ``S`` about it. Two
hypotheses, each with its own loss and its own fading::

    S / v_h ~ chi-square, n - 1 degrees of freedom           h: "seen" or "hidden"
    m - u(d) ~ N(-l_h, s_h^2),  s_h^2 = s^2 + q_h^2 + g^2    l_seen = q_seen = 0

``v_h`` is the variance of a level in time: with a line of sight one ray dominates (Rice fading, 2
to 3 dB), behind a wall or a body none does (Rayleigh fading, whose level in dB deviates by 5.57).
``u(d)`` is the path-loss model at the place that the track believes in, ``s`` its shadowing,
``l_hidden`` the mean loss of what lies between and ``q_hidden`` its deviation, and ``g`` what the
track's own doubt makes of the level: ``g^2 = grad u' P grad u``. The log-odds of a line of sight
are then, with prior probability p and k = min(n, independent readings) - 1::

    ln p / (1 - p) + k / 2 ln (v_hidden / v_seen) - k S / (2 (n - 1)) (1 / v_seen - 1 / v_hidden)
        + ln N(m - u; 0, s_seen^2) - ln N(m - u; -l_hidden, s_hidden^2)

The deviation (last line) decides where the track is well known, the fading where it is not; without
a track the deviation is not known and the fading alone speaks. A kurtosis would tell Rice from
Rayleigh too, but its standard error is sqrt(24 / n): over 1 with the 10 to 20 readings of a window,
as large as the difference that it should show. It is left out.

Decision for the window: lateration as long as one beacon in range is in line of sight, else
fingerprints (blunavi2020's rule: rooms have none).

Sources: Nguyen Ngoc Khuong, "BluNavi", Haiphong University Journal of Science 44, 2021 (the rule,
and the detector as future work); Rappaport, "Wireless Communications", 2002, ch. 5 (fading).
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.radio.path_loss import SIGMA, LevelModel, expected_levels, level_gradients
from app.core.radio.windows import Window
from app.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class LineOfSightParams:
    """What is believed of seen and of hidden beacons.

    Attributes
    ----------
    prior_probability
        Share of beacons heard that are in line of sight, before anything else is known.
    loss_db
        Mean loss of a hidden one: a partition wall takes 3 to 6 dB, a brick wall 8, a body 5 to 10.
    loss_spread_db
        Its deviation.
    seen_fading_db, hidden_fading_db
        Deviation of a level in time, see above.
    independent_readings
        Readings of a window that count as independent: a walker passes half a wavelength (6 cm)
        ten times a second, but a phone in rest does not.
    least_level_dbm
        A quieter beacon is not in range: its distance is told by noise.
    least_probability
        A beacon is in line of sight from here on.
    """

    prior_probability: float = 0.5
    loss_db: float = 8.0
    loss_spread_db: float = 4.0
    seen_fading_db: float = 2.5
    hidden_fading_db: float = 5.57
    independent_readings: int = 10
    least_level_dbm: float = -90.0
    least_probability: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Believed:
    """Where the phone is believed to be: place (2,) and covariance (2, 2)."""

    place: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """The beacons of a window.

    Attributes
    ----------
    anchor_index : (beacons,)
        Beacons in range, ascending.
    level_dbm : (beacons,)
        Mean level of each.
    probability : (beacons,)
        That it is in line of sight.
    in_sight : (beacons,)
        Those that a range may be made of.
    """

    anchor_index: IntArray
    level_dbm: FloatArray
    probability: FloatArray
    in_sight: BoolArray

    @property
    def laterate(self) -> bool:
        """Return whether ranges, not fingerprints, should tell the place."""
        return bool(self.in_sight.any())


def lines_of_sight(
    window: Window, model: LevelModel, believed: Believed | None, params: LineOfSightParams
) -> Sights:
    """Return which beacons of a window are in line of sight.

    ``window.anchor_index`` points into ``model``. Without a belief of the place the fading alone
    decides; a beacon heard once then keeps the prior.
    """
    count = np.bincount(window.anchor_index, minlength=model.anchors)
    total = np.bincount(window.anchor_index, window.rssi_dbm, model.anchors)
    mean_dbm = total / np.maximum(count, 1)
    away = window.rssi_dbm - mean_dbm[window.anchor_index]
    squares = np.bincount(window.anchor_index, away**2, model.anchors).astype(np.float64)
    which = np.flatnonzero((count > 0) & (mean_dbm >= params.least_level_dbm))
    prior = params.prior_probability
    odds = math.log(prior / (1.0 - prior)) + _of_fading(count[which], squares[which], params)
    if believed is not None:
        odds = odds + _of_level(which, mean_dbm[which], (model, believed), params)
    probability = 1.0 / (1.0 + np.exp(-odds))
    in_sight = probability >= params.least_probability
    return Sights(which, mean_dbm[which], probability, in_sight)


def _of_fading(count: IntArray, squares: FloatArray, params: LineOfSightParams) -> FloatArray:
    seen, hidden = params.seen_fading_db**2, params.hidden_fading_db**2
    freedom = np.maximum(np.minimum(count, params.independent_readings) - 1, 0)
    variance = squares / np.maximum(count - 1, 1)
    gain = math.log(hidden / seen) - variance * (1.0 / seen - 1.0 / hidden)
    return np.asarray(0.5 * freedom * gain)


def _of_level(
    which: IntArray,
    level_dbm: FloatArray,
    world: tuple[LevelModel, Believed],
    params: LineOfSightParams,
) -> FloatArray:
    model, believed = world
    x, y = believed.place[:1], believed.place[1:2]
    residual = level_dbm - expected_levels(model, x, y)[0, which]
    slope = level_gradients(model, x, y)[0, which]
    doubt = np.einsum("ia,ab,ib->i", slope, believed.covariance, slope)
    seen = model.table[which, SIGMA] ** 2 + doubt
    hidden = seen + params.loss_spread_db**2
    seen_log = -0.5 * (residual**2 / seen + np.log(seen))
    hidden_log = -0.5 * ((residual + params.loss_db) ** 2 / hidden + np.log(hidden))
    return np.asarray(seen_log - hidden_log)
