"""Matching a query with the radio map: Sørensen and cosine distance, weighted candidates."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import BLE, WIFI, RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams
from app.core.types import BoolArray, FloatArray, IntArray

LEAST_SORENSEN = 0.05
"""Two scans of one place, one after the other, are no more alike than this."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchIndex:
    """A radio map's inverted index in the matcher's representation of levels.

    ``share`` holds a = ((rssi - floor) / -floor)^e for the Sørensen distance, ``power`` the same
    with the cosine's exponent; ``share_sum`` and ``power_norm`` are their sums and norms per row,
    apart for Wi-Fi and BLE (first axis). ``crowd`` is how many fingerprints lie about each row (see
    `_crowd`), ``virtual`` 1 for those that nobody surveyed.
    """

    share: FloatArray
    power: FloatArray
    share_sum: FloatArray
    power_norm: FloatArray
    crowd: FloatArray
    virtual: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """The nearest fingerprints of one query, nearest first.

    Attributes
    ----------
    row, distance, weight, floor_index, x_m, y_m : (k,)
        Rows of the map, their distances D, their weights (sum 1) and places.
    sorensen : (k,)
        Their Sørensen distances on Wi-Fi (on BLE where no Wi-Fi was heard).
    """

    row: IntArray
    distance: FloatArray
    weight: FloatArray
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    sorensen: FloatArray

    @property
    def nearest_sorensen(self) -> float:
        """Least Sørensen distance: how well the map knows what is heard, 0 to 1."""
        return float(self.sorensen.min())


@lru_cache(maxsize=32)
def match_index(radio_map: RadioMap, params: MatchParams) -> MatchIndex:
    """Return the map's index for these parameters; computed once per map."""
    is_ble = radio_map.radio[radio_map.column] == BLE
    share = np.where(
        is_ble,
        represent(radio_map.rssi_dbm, params.ble_floor_dbm, params.ble_exponent),
        represent(radio_map.rssi_dbm, params.wifi_floor_dbm, params.sorensen_exponent),
    )
    power = represent(radio_map.rssi_dbm, params.wifi_floor_dbm, params.cosine_exponent)
    power[is_ble] = 0.0
    rows = np.repeat(np.arange(radio_map.rows), np.diff(radio_map.row_start))
    share_sum = np.stack(
        [
            np.bincount(rows, share * (is_ble == kind), radio_map.rows).astype(np.float64)
            for kind in (WIFI, BLE)
        ]
    )
    power_norm = np.sqrt(np.bincount(rows, power**2, radio_map.rows))
    by_column = np.argsort(radio_map.column, kind="stable")
    has_wifi = np.bincount(rows, ~is_ble, radio_map.rows) > 0
    crowd = _crowd(radio_map, params.crowd_m, has_wifi)
    virtual = is_virtual(radio_map).astype(np.float64)
    return MatchIndex(share[by_column], power[by_column], share_sum, power_norm, crowd, virtual)


def _crowd(radio_map: RadioMap, within_m: float, has_wifi: BoolArray) -> FloatArray:
    """Return how many fingerprints of its floor lie within a distance of each, itself one.

    Those with Wi-Fi and those of beacons alone (``has_wifi`` (rows,)) apart: where a phone without
    Wi-Fi surveyed too, scans with Wi-Fi are no likelier and no less likely than elsewhere.
    """
    crowd = np.ones(radio_map.rows)
    places = np.column_stack([radio_map.x_m, radio_map.y_m])
    group = 2 * radio_map.floor_index + has_wifi
    for one in np.unique(group):
        rows = np.flatnonzero(group == one)
        tree = cKDTree(places[rows])
        crowd[rows] = tree.query_ball_point(places[rows], within_m, return_length=True)
    return crowd


def represent(rssi_dbm: FloatArray, floor_dbm: float | FloatArray, exponent: float) -> FloatArray:
    """Return ``((rssi - floor) / -floor) ^ exponent``, 0 at and below the floor.

    Powed levels let the strong, near transmitters decide (findings on ms2020 and ujiindoorloc).
    """
    return np.maximum((rssi_dbm - floor_dbm) / -floor_dbm, 0.0) ** exponent


def match(query: Query, radio_map: RadioMap, params: MatchParams) -> Matches | None:
    """Return the ``k`` nearest fingerprints, None if no transmitter of the query is in the map.

    D = D1 + D2 + g D3 with, over transmitters t, query a and fingerprint b:
    D1 = 1 - 2 Σ min(a, b) / (Σ a + Σ b) (Wi-Fi), D2 = 1 - a·b / (|a| |b|) (Wi-Fi, other exponent),
    D3 like D1 on BLE, g = ``ble_gain`` min(1, n_ble / 3); D = D3 where no Wi-Fi was heard.
    A virtual fingerprint is ``virtual_gain`` (``virtual_even_share`` - D1_min) farther: made of
    means, it resembles many scans a little, which tells where no other resembles them at all.
    Transmitters the map does not know count in Σ a and |a|. Weights are
    those of `likeness` over m, normalised, m the number of fingerprints within ``crowd_m``: a place
    is not likelier for having been surveyed often.
    """
    index = match_index(radio_map, params)
    wifi = _Side.of(query.wifi_dbm, radio_map, params.wifi_floor_dbm, params.sorensen_exponent)
    ble = _Side.of(query.ble_dbm, radio_map, params.ble_floor_dbm, params.ble_exponent)
    if not len(wifi.column) + len(ble.column):
        return None
    power = represent(wifi.level_dbm, params.wifi_floor_dbm, params.cosine_exponent)
    all_power = represent(
        np.array(list(query.wifi_dbm.values()), dtype=np.float64),
        params.wifi_floor_dbm,
        params.cosine_exponent,
    )
    ble_gain = params.ble_gain * min(1.0, len(query.ble_dbm) / 3.0)
    distance, sorensen = _distances(
        (radio_map.column_start, radio_map.row),
        (index.share, index.power, index.share_sum, index.power_norm),
        (wifi.column, wifi.share, power),
        (ble.column, ble.share),
        (wifi.total, math.sqrt(float(all_power @ all_power)), ble.total, ble_gain),
    )
    distance += params.virtual_gain * (params.virtual_even_share - sorensen.min()) * index.virtual
    k = min(params.k, len(distance))
    row = np.argpartition(distance, k - 1)[:k]
    row = row[np.lexsort((row, distance[row]))]
    weight = likeness(distance[row], sorensen[row], params) / index.crowd[row]
    return Matches(
        row=row,
        distance=distance[row],
        weight=weight / weight.sum(),
        floor_index=radio_map.floor_index[row],
        x_m=radio_map.x_m[row],
        y_m=radio_map.y_m[row],
        sorensen=sorensen[row],
    )


def likeness(distance: FloatArray, sorensen: FloatArray, params: MatchParams) -> FloatArray:
    """Return how likely each of some fingerprints (k,) is the query's place, 1 for the nearest.

    exp(-(D - D_min) / (``softness_ratio`` D1_min)): the less even the nearest resembles what is
    heard, the less a difference between two of them tells.
    """
    softness = params.softness_ratio * max(float(sorensen.min()), LEAST_SORENSEN)
    return np.asarray(np.exp((distance.min() - distance) / softness))


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    column: IntArray
    level_dbm: FloatArray
    share: FloatArray
    total: float

    @classmethod
    def of(
        cls, levels_dbm: dict[str, float], radio_map: RadioMap, floor_dbm: float, exponent: float
    ) -> "_Side":
        # Sorted, so that sums do not depend on the order in which the phone listed them.
        items = sorted(levels_dbm.items())
        share = represent(np.array([v for _, v in items], dtype=np.float64), floor_dbm, exponent)
        column = np.array([radio_map.column_by_key.get(k, -1) for k, _ in items], dtype=np.int64)
        level_dbm = np.array([v for _, v in items], dtype=np.float64)
        known = column >= 0
        return cls(column[known], level_dbm[known], share[known], float(share.sum()))


@njit(cache=True)
def _distances(
    inverted: tuple[IntArray, IntArray],
    levels: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    wifi: tuple[IntArray, FloatArray, FloatArray],
    ble: tuple[IntArray, FloatArray],
    totals: tuple[float, float, float, float],
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    column_start, row = inverted
    share, power, share_sum, power_norm = levels
    wifi_column, wifi_share, wifi_power = wifi
    ble_column, ble_share = ble
    wifi_total, wifi_norm, ble_total, ble_gain = totals
    rows = share_sum.shape[1]
    overlap = np.zeros(rows)
    dot = np.zeros(rows)
    for i in range(len(wifi_column)):
        for entry in range(column_start[wifi_column[i]], column_start[wifi_column[i] + 1]):
            overlap[row[entry]] += min(wifi_share[i], share[entry])
            dot[row[entry]] += wifi_power[i] * power[entry]
    overlap_ble = np.zeros(rows)
    for i in range(len(ble_column)):
        for entry in range(column_start[ble_column[i]], column_start[ble_column[i] + 1]):
            overlap_ble[row[entry]] += min(ble_share[i], share[entry])
    distance = np.empty(rows)
    sorensen = np.empty(rows)
    for r in range(rows):
        total = wifi_total + share_sum[0, r]
        sorensen[r] = 1.0 - 2.0 * overlap[r] / total if total > 0.0 else 1.0
        norm = wifi_norm * power_norm[r]
        cosine = 1.0 - dot[r] / norm if norm > 0.0 else 1.0
        total_ble = ble_total + share_sum[1, r]
        d_ble = 1.0 - 2.0 * overlap_ble[r] / total_ble if total_ble > 0.0 else 1.0
        distance[r] = sorensen[r] + cosine + ble_gain * d_ble
        if wifi_total == 0.0:
            distance[r] = sorensen[r] = d_ble
    return distance, sorensen
