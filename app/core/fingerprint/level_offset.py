"""The phone's level offset against the map: phones hear the same signal up to 10 dB apart.

The offset o is a scalar Kalman state, N(0, ``prior_db``²) before anything is heard. A scan, less
the offset known so far, is matched; what is left between its levels and those of the fingerprints
that it resembles is a measurement of the rest:

    z = median over transmitters t of (u_t - o - Σ_r w_r u_rt / Σ_r w_r),  o += P / (P + noise²) z

over the matched rows r of weight w_r that have t. Matching finds the rows whose levels fit the scan
as it is, so z is too small at first, and the first scan looks farther: it is matched with several
offsets, and the one of least `TRUST` D + o² / (2 prior²) is where the filter starts.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fingerprint.heard import Heard
from app.core.fingerprint.matching import Matches, match_heard
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import LevelOffsetParams, MatchParams
from app.core.types import FloatArray, IntArray

TRUST = 8.0
"""Log odds per unit of distance. Half of what the distances of one scan tell: on a sparse map a
wrong offset may happen to look better."""


@dataclass(frozen=True, slots=True)
class LevelOffset:
    """What the phone hears more than the phones of the survey, with its variance."""

    mean_db: float
    variance_db2: float


def first_offset(
    heard: Heard, radio_map: RadioMap, matching: MatchParams, params: LevelOffsetParams
) -> tuple[LevelOffset, Matches | None]:
    """Return the offset of those tried with which the map knows the session's first scan best.

    And what the scan less that offset was matched with.
    """
    best_db, best, least = 0.0, None, np.inf
    for offset_db in params.tried_db:
        matches = match_heard(heard.less(offset_db), radio_map, matching)
        if matches is not None:
            cost = TRUST * matches.distance[0]
            cost += 0.5 * (offset_db / params.prior_db) ** 2
            if cost < least:
                best_db, best, least = offset_db, matches, cost
    return LevelOffset(best_db, params.prior_db**2), best


def learned(
    offset: LevelOffset,
    heard: Heard,
    matches: Matches,
    radio_map: RadioMap,
    params: LevelOffsetParams,
) -> LevelOffset:
    """Return the offset after a scan, which was matched as ``heard`` less the offset so far."""
    levels = heard.wifi if len(heard.wifi) else heard.ble
    residual_db = _median_residual_db(
        (levels.column, levels.level_dbm),
        (matches.row, matches.weight),
        (radio_map.row_start, radio_map.column, radio_map.rssi_dbm),
        len(radio_map.transmitters),
        (params.least_dbm, params.min_transmitters),
    )
    if math.isnan(residual_db):
        return offset
    variance_db2 = offset.variance_db2 + params.walk_db2
    gain = variance_db2 / (variance_db2 + params.noise_db**2)
    return LevelOffset(offset.mean_db + gain * residual_db, (1.0 - gain) * variance_db2)


@njit(cache=True)
def _median_residual_db(
    heard: tuple[IntArray, FloatArray],
    matched: tuple[IntArray, FloatArray],
    rows: tuple[IntArray, IntArray, FloatArray],
    columns: int,
    limits: tuple[float, int],
) -> float:  # pragma: no cover - compiled
    """Return the median of heard less expected; nan where too few transmitters tell it.

    Expected is the weighted mean level of the matched rows that have the transmitter.
    """
    wanted, level_dbm = heard
    row_start, column, rssi_dbm = rows
    least_dbm, min_transmitters = limits
    place = np.full(columns, -1, dtype=np.int64)
    for i in range(len(wanted)):
        if wanted[i] >= 0 and level_dbm[i] > least_dbm:
            place[wanted[i]] = i
    total, weight = np.zeros(len(wanted)), np.zeros(len(wanted))
    for k in range(len(matched[0])):
        row, share = matched[0][k], matched[1][k]
        for entry in range(row_start[row], row_start[row + 1]):
            i = place[column[entry]]
            if i >= 0:
                total[i] += share * rssi_dbm[entry]
                weight[i] += share
    told = weight > 0.0
    if told.sum() < min_transmitters:
        return math.nan
    return float(np.median(level_dbm[told] - total[told] / weight[told]))
