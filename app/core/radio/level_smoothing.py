"""Level smoothing: a scalar Kalman filter per transmitter that starts anew when the level jumps.

Between jumps it is the plain filter of a constant level (F = H = 1)::

    P' = P + Q,    K = P' / (P' + R),    x = x + K (z - x),    P = (1 - K) P'

whose gain soon settles at 0.12, so that alone it needs 18 samples for nine tenths of a step. A
step is seen by the mean ``psi(k)`` of the last ``alpha`` measurements, which leaves the estimate
behind::

    Phi(k) = |psi(k) - x(k - 1)| / (beta P(k - 1) / P_inf)

``P_inf`` is the variance the filter settles at. ``Phi > gamma`` is a jump: P' becomes ``P_0``, the
estimate takes the new level and converges anew, and the measurements before it are forgotten. Just
after that P is up to eight times ``P_inf`` and as many times more is needed for the next jump, so
the same one is not found twice.

The paper's equations 10 to 12 (psi, Phi and what is done at a jump) are lost in print; this form is
ours. It keeps what the text says of them: the mean over alpha measurements, its distance from the
estimate, damping by beta and by P(k - 1). Settled, the threshold is ``beta gamma`` = 2 dB. Noise of
3 dB moves psi - x by 0.6 dB (1 sigma), so it seldom jumps there; 4 dB are too much. One measurement
alone moves psi by an eighth of what it is off, so that a single one, 15 dB too low, is no jump.

The printed gain ``K = H P H' + R`` lacks the inverse.

Source: Tao, Yang, Wang, Zhang, "Indoor fingerprint location optimization technology based on BLE",
Journal of Anhui Agricultural Sciences 44(8), 2016.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

SAME_TIME_S = 1e-3
"""Nearer in time is the same measurement: ages come in milliseconds, and times are rounded."""


@dataclass(frozen=True, slots=True)
class LevelSmoothingParams:
    """Parameters of the jump-adaptive filter; all but the last as published.

    Attributes
    ----------
    measurement_variance_db2, process_variance_db2
        ``R`` and ``Q``: of a measurement, and of the level's change from one to the next. Only
        their ratio tells the estimate.
    jump_window
        ``alpha``: measurements whose mean finds a jump.
    jump_scale_db, jump_ratio
        ``beta`` and ``gamma``: a settled filter jumps where the mean is off by more than their
        product.
    start_variance_db2
        ``P_0``, before the first measurement and at a jump: so much more than R that the
        measurement is taken as it is (gain 0.97).
    """

    measurement_variance_db2: float = 0.3
    process_variance_db2: float = 0.005
    jump_window: int = 8
    jump_scale_db: float = 4.0
    jump_ratio: float = 0.5
    start_variance_db2: float = 10.0

    @property
    def settled_variance_db2(self) -> float:
        """Return ``P_inf``: the positive root of ``P = (P + Q) R / (P + Q + R)``."""
        q, r = self.process_variance_db2, self.measurement_variance_db2
        return 0.5 * (math.sqrt(q * q + 4.0 * q * r) - q)


@dataclass(frozen=True, slots=True)
class SmoothedLevel:
    """The filter of one transmitter.

    Attributes
    ----------
    level_dbm, variance_db2
        The estimate and its variance P, on the scale of R.
    recent_dbm
        The last measurements, oldest first, at most ``jump_window``, none from before a jump.
    """

    level_dbm: float
    variance_db2: float
    recent_dbm: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class HeardLevel:
    """A transmitter's filter and when it was last fed."""

    time_s: float
    smoothed: SmoothedLevel


@dataclass(frozen=True, slots=True)
class LevelMemory:
    """What a session remembers of levels: a filter per transmitter key heard lately."""

    by_key: dict[str, HeardLevel]


class Measurement(NamedTuple):
    """One level of one transmitter, at the time it was measured."""

    key: str
    time_s: float
    rssi_dbm: float


def listen(
    memory: LevelMemory,
    measurements: Iterable[Measurement],
    now_s: float,
    hold_s: float,
    params: LevelSmoothingParams,
) -> LevelMemory:
    """Return the memory after further measurements, without what is older than ``hold_s``.

    A measurement that is no newer than its transmitter's last is passed over: phones report what
    they have heard once again and again.
    """
    by_key = dict(memory.by_key)
    for key, time_s, rssi_dbm in sorted(measurements):
        before = by_key.get(key)
        if before is None or time_s - before.time_s > hold_s:
            by_key[key] = HeardLevel(time_s, first_level(rssi_dbm, params))
        elif time_s - before.time_s > SAME_TIME_S:
            by_key[key] = HeardLevel(time_s, next_level(before.smoothed, rssi_dbm, params))
    return LevelMemory({k: h for k, h in by_key.items() if now_s - h.time_s <= hold_s})


def first_level(rssi_dbm: float, params: LevelSmoothingParams) -> SmoothedLevel:
    """Return the filter after a transmitter's first measurement."""
    gain = _gain(params.start_variance_db2, params)
    return SmoothedLevel(rssi_dbm, (1.0 - gain) * params.start_variance_db2, (rssi_dbm,))


def next_level(
    before: SmoothedLevel, rssi_dbm: float, params: LevelSmoothingParams
) -> SmoothedLevel:
    """Return the filter after one more measurement."""
    recent_dbm = (*before.recent_dbm, rssi_dbm)[-params.jump_window :]
    prior_db2 = before.variance_db2 + params.process_variance_db2
    if jump_measure(before, recent_dbm, params) > params.jump_ratio:
        recent_dbm, prior_db2 = (rssi_dbm,), params.start_variance_db2
    gain = _gain(prior_db2, params)
    level_dbm = before.level_dbm + gain * (rssi_dbm - before.level_dbm)
    return SmoothedLevel(level_dbm, (1.0 - gain) * prior_db2, recent_dbm)


def jump_measure(
    before: SmoothedLevel, recent_dbm: tuple[float, ...], params: LevelSmoothingParams
) -> float:
    """Return ``Phi``: how far the mean of recent measurements is from the estimate before them."""
    off_db = abs(math.fsum(recent_dbm) / len(recent_dbm) - before.level_dbm)
    damping_db = params.jump_scale_db * before.variance_db2 / params.settled_variance_db2
    return off_db / damping_db


def _gain(prior_db2: float, params: LevelSmoothingParams) -> float:
    return prior_db2 / (prior_db2 + params.measurement_variance_db2)
