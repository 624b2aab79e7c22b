"""Nearest neighbours on scans of unequal length: what both heard is compared, absence costs.

Equation
--------
Between a scan a and a fingerprint b, C the access points both heard, A those only one of them did::

    d^2 = (sum_C w_t min(|a_t - b_t|, D)^2 + sum_A w_t P^2) / (sum_C w_t + sum_A w_t)

d in dB. An access point that is absent counts as if it were P dB apart; one that both heard never
counts more than D. ``w_t = max((level - floor) / -floor, 0)^e`` with the stronger of its levels: of
two places a near access point says more than a far one, and its absence too. The fix is the mean of
the k nearest fingerprints, weights exp(-(d - d_min) / softness).

Source: Liu et al., Computer Science 43(1), 2016: only access points in common are compared, and
absence is penalised. Its penalty is not known to us; P, D and the weights w_t are ours.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.derived import derived
from app.core.fingerprint.match_index import represent
from app.core.fingerprint.radio_map import WIFI, RadioMap
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class UnequalLengthParams:
    """Parameters of the matcher, fitted on ms2020 (fold 1 against a map of folds 2 and 3).

    Attributes
    ----------
    absence_db
        P: with 15 dB the profile's error is 7 % larger, between 20 and 30 it changes by 2 %.
    most_db
        D: a body or a hand takes 15 to 20 dB; without a bound the error is 2 % larger.
    strength_exponent
        e: with 2 the error is 4 % larger; with 0, all access points counting alike, 31 %.
    floor_dbm
        Level that counts as not heard.
    k, softness_db
        Neighbours, and the scale of their weights: half a dB leaves about five that count. Means
        over more are drawn to the middle.
    outside_db
        Where even the nearest fingerprint is farther, the phone is not in the mapped area; on
        ms2020's tuning walks it is 13 dB away in the median and 22.3 at most.
    """

    absence_db: float = 25.0
    most_db: float = 16.0
    strength_exponent: float = 3.0
    floor_dbm: float = -100.0
    k: int = 15
    softness_db: float = 0.5
    outside_db: float = 22.5


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The nearest fingerprints of one scan, nearest first.

    Attributes
    ----------
    row, weight, floor_index, x_m, y_m, distance_db : (k,)
        Rows of the map, their weights (sum 1), places and distances.
    """

    row: IntArray
    weight: FloatArray
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    distance_db: FloatArray


def nearest_of_unequal_length(
    levels_dbm: dict[str, float], radio_map: RadioMap, params: UnequalLengthParams
) -> Neighbours | None:
    """Return the ``k`` nearest fingerprints, None if no access point of the scan is in the map.

    Those that the map does not know are absent from every fingerprint.
    """
    # Sorted, so that sums do not depend on the order in which the phone listed them.
    items = sorted(levels_dbm.items())
    column = np.array([radio_map.column_by_key.get(key, -1) for key, _ in items], dtype=np.int64)
    level_dbm = np.array([level for _, level in items], dtype=np.float64)
    strength = represent(level_dbm, params.floor_dbm, params.strength_exponent)
    known = column >= 0
    if not known.any():
        return None
    index = _strengths(radio_map, params)
    distance_db = _distances_db(
        (radio_map.column_start, radio_map.row, radio_map.column_rssi_dbm),
        index,
        (column[known], level_dbm[known], strength[known]),
        float(strength.sum()),
        (params.absence_db, params.most_db),
    )
    k = min(params.k, len(distance_db))
    row = np.argpartition(distance_db, k - 1)[:k]
    row = row[np.lexsort((row, distance_db[row]))]
    weight = np.exp(-(distance_db[row] - distance_db[row[0]]) / params.softness_db)
    return Neighbours(
        row=row,
        weight=weight / weight.sum(),
        floor_index=radio_map.floor_index[row],
        x_m=radio_map.x_m[row],
        y_m=radio_map.y_m[row],
        distance_db=distance_db[row],
    )


@derived()
def _strengths(radio_map: RadioMap, params: UnequalLengthParams) -> tuple[FloatArray, FloatArray]:
    """Return the strength of every Wi-Fi level, by column, and their sum per row."""
    strength = represent(radio_map.column_rssi_dbm, params.floor_dbm, params.strength_exponent)
    strength[np.repeat(radio_map.radio, np.diff(radio_map.column_start)) != WIFI] = 0.0
    return strength, np.bincount(radio_map.row, strength, radio_map.rows).astype(np.float64)


@njit(cache=True)
def _distances_db(
    inverted: tuple[IntArray, IntArray, FloatArray],
    strengths: tuple[FloatArray, FloatArray],
    scan: tuple[IntArray, FloatArray, FloatArray],
    scan_sum: float,
    limits: tuple[float, float],
) -> FloatArray:  # pragma: no cover - compiled
    column_start, row, level = inverted
    strength, row_sum = strengths
    scan_column, scan_level, scan_strength = scan
    absence, most = limits
    rows = len(row_sum)
    apart = np.zeros(rows)
    both = np.zeros(rows)
    shared = np.zeros(rows)
    for i in range(len(scan_column)):
        for entry in range(column_start[scan_column[i]], column_start[scan_column[i] + 1]):
            r = row[entry]
            weight = max(scan_strength[i], strength[entry])
            apart[r] += weight * min(abs(scan_level[i] - level[entry]), most) ** 2
            both[r] += weight
            shared[r] += scan_strength[i] + strength[entry]
    distance = np.empty(rows)
    for r in range(rows):
        absent = max(scan_sum + row_sum[r] - shared[r], 0.0)
        total = both[r] + absent
        distance[r] = absence
        if total > 0.0:
            distance[r] = np.sqrt((apart[r] + absence**2 * absent) / total)
    return distance
