"""The phone's level offset against the map: phones hear the same signal up to 10 dB apart.

The offset o is a scalar Kalman state, N(0, ``prior_db``²) before anything is heard. A scan, less
the offset known so far, is matched; what is left between its levels and those of the fingerprints
that it resembles is a measurement of the rest:

    z = median over transmitters t of (u_t - o - Σ_r w_r u_rt / Σ_r w_r),  o += P / (P + noise²) z

over the matched rows r of weight w_r that have t. Matching finds the rows whose levels fit the scan
as it is, so z is too small at first, and the first scan looks farther: it is matched with several
offsets, and the one of least `TRUST` D + o² / (2 prior²) is where the filter starts.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fingerprint.matching import Matches, match
from app.core.fingerprint.query import Query
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


def without_offset(query: Query, offset_db: float) -> Query:
    """Return the levels as the phones of the survey would have heard them."""
    return Query(
        {key: level - offset_db for key, level in query.wifi_dbm.items()},
        {key: level - offset_db for key, level in query.ble_dbm.items()},
    )


def first_offset(
    query: Query, radio_map: RadioMap, matching: MatchParams, params: LevelOffsetParams
) -> LevelOffset:
    """Return the offset of those tried with which the map knows the session's first scan best."""
    best_db, least = 0.0, np.inf
    for offset_db in params.tried_db:
        matches = match(without_offset(query, offset_db), radio_map, matching)
        if matches is not None:
            cost = TRUST * matches.distance[0]
            cost += 0.5 * (offset_db / params.prior_db) ** 2
            if cost < least:
                best_db, least = offset_db, cost
    return LevelOffset(best_db, params.prior_db**2)


def learned(
    offset: LevelOffset,
    query: Query,
    matches: Matches,
    radio_map: RadioMap,
    params: LevelOffsetParams,
) -> LevelOffset:
    """Return the offset after a scan, whose ``query`` was matched without the offset so far."""
    residual_db = _median_residual_db(query, matches, radio_map, params)
    if residual_db is None:
        return offset
    variance_db2 = offset.variance_db2 + params.walk_db2
    gain = variance_db2 / (variance_db2 + params.noise_db**2)
    return LevelOffset(offset.mean_db + gain * residual_db, (1.0 - gain) * variance_db2)


def _median_residual_db(
    query: Query, matches: Matches, radio_map: RadioMap, params: LevelOffsetParams
) -> float | None:
    """Return the median of heard less expected; None where too few transmitters tell it."""
    levels = query.wifi_dbm or query.ble_dbm
    heard = sorted(
        (radio_map.column_by_key[key], level)
        for key, level in levels.items()
        if key in radio_map.column_by_key and level > params.least_dbm
    )
    if len(heard) < params.min_transmitters:
        return None
    column, level_dbm = (np.array(part) for part in zip(*heard, strict=True))
    expected_dbm = _expected_dbm(
        column.astype(np.int64),
        (matches.row, matches.weight),
        (radio_map.row_start, radio_map.column, radio_map.rssi_dbm),
        len(radio_map.transmitters),
    )
    residual_db = (level_dbm - expected_dbm)[~np.isnan(expected_dbm)]
    if len(residual_db) < params.min_transmitters:
        return None
    return float(np.median(residual_db))


@njit(cache=True)
def _expected_dbm(
    wanted: IntArray,
    matched: tuple[IntArray, FloatArray],
    rows: tuple[IntArray, IntArray, FloatArray],
    columns: int,
) -> FloatArray:  # pragma: no cover - compiled
    """Return the weighted mean level of each wanted column; nan where no matched row has it."""
    row_start, column, rssi_dbm = rows
    place = np.full(columns, -1, dtype=np.int64)
    for i in range(len(wanted)):
        place[wanted[i]] = i
    total, weight = np.zeros(len(wanted)), np.zeros(len(wanted))
    for k in range(len(matched[0])):
        row, share = matched[0][k], matched[1][k]
        for entry in range(row_start[row], row_start[row + 1]):
            i = place[column[entry]]
            if i >= 0:
                total[i] += share * rssi_dbm[entry]
                weight[i] += share
    for i in range(len(wanted)):
        total[i] = total[i] / weight[i] if weight[i] > 0.0 else np.nan
    return total
