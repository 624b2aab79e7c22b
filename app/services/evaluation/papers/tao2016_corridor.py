"""The simulated corridor of tao2016: 40 points at 1 m, BLE levels that fade and are blocked.

A level is ``u = u* - 10 n log10(d) + s(x) + f - b``, rounded to whole decibels:

- ``s`` is shadowing that belongs to the place, so the map knows it: a Gaussian field per beacon
  with correlation ``exp(-r / 4 m)`` (Gudmundson 1991), made of random Fourier features;
- ``f`` is fading, new with every advertisement, since these hop between three channels and the
  phone is in a hand: the power of a Rice channel, ``K`` times as strong on its direct path;
- ``b`` is 8 to 20 dB while somebody passes between beacon and phone, which takes 0.6 s (half a
  metre of body and the path's own width, at walking pace) and is so for a tenth of the time.
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.types import BoolArray, FloatArray

POINTS, SPACING_M = 40, 1.0
BEACONS, LENGTH_M, HALF_WIDTH_M, OVER_PHONE_M = 4, 40.0, 1.0, 1.3
REF_LEVEL_DBM, PATH_LOSS_EXPONENT = -59.0, 1.8
SHADOWING_DB, CORRELATION_M, FEATURES = 3.0, 4.0, 64
K_FACTOR = 10.0
"""10 dB: in sight of the beacon; the level alone then scatters by 2 dB."""
LOSS_DB = (8.0, 20.0)
ADVERTISING_S, RECEIVED_SHARE = 0.25, 0.8
DETECTION_DBM = -100.0


@dataclass(frozen=True, slots=True)
class Blocking:
    """How long, on average, a body stays in the way; for what share of the time one is there."""

    mean_s: float = 0.6
    time_share: float = 0.1


PASSERS_BY = Blocking()


class Corridor:
    """A corridor with beacons on alternate sides, and shadowing drawn for it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        side = np.where(np.arange(BEACONS) % 2, HALF_WIDTH_M, -HALF_WIDTH_M)
        self._beacon_x_m = np.linspace(0.0, LENGTH_M, BEACONS)
        self._aside_m = np.hypot(side, OVER_PHONE_M)
        # In one dimension the exponential correlation has a Cauchy spectrum.
        self._frequency = rng.standard_cauchy((BEACONS, FEATURES)) / CORRELATION_M
        self._phase = rng.uniform(0.0, 2.0 * math.pi, (BEACONS, FEATURES))

    def mean_levels_dbm(self, x_m: FloatArray) -> FloatArray:
        """Return levels before fading and blocking, (places, beacons)."""
        distance_m = np.hypot(x_m[:, None] - self._beacon_x_m, self._aside_m)
        waves = np.cos(x_m[:, None, None] * self._frequency + self._phase)
        shadowing_db = SHADOWING_DB * math.sqrt(2.0 / FEATURES) * waves.sum(axis=2)
        loss_db = 10.0 * PATH_LOSS_EXPONENT * np.log10(distance_m)
        return np.asarray(REF_LEVEL_DBM - loss_db + shadowing_db)

    def listen_dbm(self, x_m: FloatArray, seconds: float, blocking: Blocking) -> FloatArray:
        """Return what a phone hears standing at places, (places, advertisements, beacons).

        Advertisements that were not received are nan.
        """
        rng = self._rng
        shape = (len(x_m), round(seconds / ADVERTISING_S), BEACONS)
        sway = rng.normal(size=(2, *shape)) * math.sqrt(0.5 / (K_FACTOR + 1.0))
        direct = math.sqrt(K_FACTOR / (K_FACTOR + 1.0))
        fading_db = 10.0 * np.log10((direct + sway[0]) ** 2 + sway[1] ** 2)
        blocked = self._blocked(shape, blocking)
        began = blocked & ~np.roll(blocked, 1, axis=1)
        began[:, 0] = True
        # Each passage has one loss, which stays until the next begins.
        passage = np.maximum.accumulate(np.where(began, np.arange(shape[1])[:, None], 0), axis=1)
        loss_db = np.take_along_axis(rng.uniform(*LOSS_DB, shape), passage, axis=1)
        level_dbm = self.mean_levels_dbm(x_m)[:, None] + fading_db - np.where(blocked, loss_db, 0.0)
        heard = (rng.random(shape) < RECEIVED_SHARE) & (level_dbm >= DETECTION_DBM)
        return np.where(heard, np.round(level_dbm), np.nan)

    def _blocked(self, shape: tuple[int, int, int], blocking: Blocking) -> BoolArray:
        """Return when somebody is in the way: a chain of two states per place and beacon."""
        leave = ADVERTISING_S / blocking.mean_s
        enter = leave * blocking.time_share / (1.0 - blocking.time_share)
        chance = self._rng.random(shape)
        blocked = np.empty(shape, dtype=np.bool_)
        blocked[:, 0] = chance[:, 0] < blocking.time_share
        for i in range(1, shape[1]):
            blocked[:, i] = np.where(blocked[:, i - 1], chance[:, i] >= leave, chance[:, i] < enter)
        return blocked
