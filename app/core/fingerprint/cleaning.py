"""Gauss-mean cleaning: the level of a transmitter at a place, without what came in between.

Levels of one transmitter at one reference point scatter by fading, and now and then a body or a
collision takes 10 to 20 dB more. With mean ``mu`` and variance ``sigma^2`` of the n levels u_i, the
normal density of a level against its greatest is ``exp(-(u - mu)^2 / (2 sigma^2))``; kept is what
reaches ``k`` of it::

    |u_i - mu| <= sigma sqrt(2 ln(1 / k))

and the level stored is the mean of what is kept. ``sigma^2`` divides by n, so that some level is
always within one sigma of the mean: with ``k <= exp(-1/2)`` something is kept of any sample. With
the published k = 0.6 the bound is 1.01 sigma.

Of normal levels the cut keeps the middle ones, whose deviation is smaller by the known ratio::

    c^2 = 1 - 2 b phi(b) / (2 Phi(b) - 1),    b = sqrt(2 ln(1 / k))

(0.54 for k = 0.6). The deviation told is the one of the kept levels over ``c``: the scatter of a
level around the mean when nothing is in the way.

Source: Tao, Yang, Wang, Zhang, "Indoor fingerprint location optimization technology based on BLE",
Journal of Anhui Agricultural Sciences 44(8), 2016.
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.types import FloatArray, IntArray

MAX_DENSITY_RATIO = math.exp(-0.5)
"""Above this the bound is under one sigma, and of two levels none would be kept."""


@dataclass(frozen=True, slots=True)
class CleaningParams:
    """Parameters of Gauss-mean cleaning.

    Attributes
    ----------
    density_ratio
        ``k`` above, more than 0 and at most `MAX_DENSITY_RATIO`; 0.6 as published.

    Raises
    ------
    ValueError
        If ``density_ratio`` is outside these bounds.
    """

    density_ratio: float = 0.6

    def __post_init__(self) -> None:
        if not 0.0 < self.density_ratio <= MAX_DENSITY_RATIO:
            msg = f"density ratio {self.density_ratio} is not in (0, {MAX_DENSITY_RATIO:.4f}]"
            raise ValueError(msg)


@dataclass(frozen=True, slots=True, eq=False)
class CleanedLevels:
    """What each transmitter sounds like at each reference point, by point, then transmitter.

    Attributes
    ----------
    point, transmitter : (entries,)
        The pair that an entry is of; pairs that were never heard have none.
    mean_dbm : (entries,)
        Mean of the levels kept.
    deviation_db : (entries,)
        Standard deviation that the levels kept speak of (see above); 0 where only one was heard.
    count : (entries,)
        Levels heard, kept or not.
    heard_share : (entries,)
        Levels heard over scans made at the point.
    """

    point: IntArray
    transmitter: IntArray
    mean_dbm: FloatArray
    deviation_db: FloatArray
    count: IntArray
    heard_share: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LevelStatistics:
    """What is kept of the cleaning beside the levels, one number per level of a radio map.

    Attributes
    ----------
    deviation_db, count, heard_share : (entries,)
        As in `CleanedLevels`; 0, 1 and 1 of the level of a single scan, all 0 of a computed one.
    """

    deviation_db: FloatArray
    count: IntArray
    heard_share: FloatArray


def clean_levels(
    point: IntArray,
    transmitter: IntArray,
    rssi_dbm: FloatArray,
    scans: IntArray,
    params: CleaningParams,
) -> CleanedLevels:
    """Return the cleaned level of every transmitter at every reference point that heard it.

    Parameters
    ----------
    point, transmitter, rssi_dbm : (levels,)
        The survey's levels, in any order: where, whose, how loud.
    scans : (points,)
        How many scans were made at each reference point.
    """
    columns = int(transmitter.max(initial=-1)) + 1
    pair, entry = np.unique(point * columns + transmitter, return_inverse=True)
    count = np.bincount(entry, minlength=len(pair))
    kept = _within_bound(rssi_dbm, entry, count, params)
    mean_dbm, variance = _moments(rssi_dbm[kept], entry[kept], len(pair))
    at = pair // max(columns, 1)
    return CleanedLevels(
        point=at,
        transmitter=pair % max(columns, 1),
        mean_dbm=mean_dbm,
        deviation_db=np.sqrt(variance) / _kept_deviation_ratio(params),
        count=count,
        heard_share=count / scans[at],
    )


def gauss_mean_dbm(rssi_dbm: FloatArray, params: CleaningParams) -> float:
    """Return the cleaned level of one transmitter at one place: the mean of the levels kept.

    Parameters
    ----------
    rssi_dbm : (levels,)
        At least one.
    """
    off_db = rssi_dbm - rssi_dbm.mean()
    kept = np.abs(off_db) <= _bound(params) * math.sqrt(float(off_db @ off_db) / len(off_db))
    return float(rssi_dbm[kept].mean())


def _bound(params: CleaningParams) -> float:
    """Return how many sigmas from the mean a level may lie."""
    return math.sqrt(-2.0 * math.log(params.density_ratio))


def _within_bound(
    rssi_dbm: FloatArray, entry: IntArray, count: IntArray, params: CleaningParams
) -> IntArray:
    mean_dbm, variance = _moments(rssi_dbm, entry, len(count))
    bound_db = _bound(params) * np.sqrt(variance)
    return np.flatnonzero(np.abs(rssi_dbm - mean_dbm[entry]) <= bound_db[entry])


def _moments(rssi_dbm: FloatArray, entry: IntArray, entries: int) -> tuple[FloatArray, FloatArray]:
    count = np.bincount(entry, minlength=entries)
    mean_dbm = np.bincount(entry, rssi_dbm, entries) / count
    variance = np.bincount(entry, np.square(rssi_dbm - mean_dbm[entry]), entries) / count
    return mean_dbm, variance


def _kept_deviation_ratio(params: CleaningParams) -> float:
    """Return the deviation of normal levels within the bound over that of all of them."""
    b = _bound(params)
    density = math.exp(-0.5 * b * b) / math.sqrt(2.0 * math.pi)
    return math.sqrt(1.0 - 2.0 * b * density / math.erf(b / math.sqrt(2.0)))
