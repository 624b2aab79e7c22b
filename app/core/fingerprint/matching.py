"""Matching a query with the radio map: Sørensen and cosine distance, weighted candidates."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from app.core.fingerprint.heard import Heard, heard_in
from app.core.fingerprint.match_index import match_index, represent
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.core.types import FloatArray, IntArray

LEAST_SORENSEN = 0.05
"""Two scans of one place, one after the other, are no more alike than this."""

MANY = 500
"""For more rows than this all are sorted: putting each into its place takes k times as long."""


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
    return match_heard(heard_in(query, radio_map), radio_map, params)


def match_heard(heard: Heard, radio_map: RadioMap, params: MatchParams) -> Matches | None:
    """Do the same for a query that was looked up in the map before."""
    if not heard.is_known:
        return None
    index, (wifi, ble) = match_index(radio_map, params), (heard.wifi, heard.ble)
    share = represent(wifi.level_dbm, params.wifi_floor_dbm, params.sorensen_exponent)
    power = represent(wifi.level_dbm, params.wifi_floor_dbm, params.cosine_exponent)
    ble_share = represent(ble.level_dbm, params.ble_floor_dbm, params.ble_exponent)
    row, distance, sorensen = _nearest_of_all(
        (index.start, index.row),
        (index.share, index.power, index.share_sum, index.power_norm),
        index.joined(wifi, share, power),
        (*index.joined(ble, ble_share, ble_share)[:2], params.ble_gain * min(1.0, len(ble) / 3.0)),
        (index.virtual, params.virtual_gain, params.virtual_even_share),
        min(params.k, radio_map.rows),
    )
    weight = likeness(distance, sorensen, params) / index.crowd[row]
    return Matches(
        row=row,
        distance=distance,
        weight=weight / weight.sum(),
        floor_index=radio_map.floor_index[row],
        x_m=radio_map.x_m[row],
        y_m=radio_map.y_m[row],
        sorensen=sorensen,
    )


def likeness(distance: FloatArray, sorensen: FloatArray, params: MatchParams) -> FloatArray:
    """Return how likely each of some fingerprints (k,) is the query's place, 1 for the nearest.

    exp(-(D - D_min) / (``softness_ratio`` D1_min)): the less even the nearest resembles what is
    heard, the less a difference between two of them tells.
    """
    softness = params.softness_ratio * max(float(sorensen.min()), LEAST_SORENSEN)
    return np.asarray(np.exp((distance.min() - distance) / softness))


@njit(cache=True)
def _nearest_of_all(
    inverted: tuple[IntArray, npt.NDArray[np.uint32]],
    levels: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    wifi: tuple[IntArray, FloatArray, FloatArray],
    ble: tuple[IntArray, FloatArray, float],
    virtual: tuple[FloatArray, float, float],
    k: int,
) -> tuple[IntArray, FloatArray, FloatArray]:  # pragma: no cover - compiled
    """Return the k nearest rows, their distances and their Sørensen distances."""
    distance, sorensen = _distances(inverted, levels, wifi, ble)
    is_virtual, gain, even_share = virtual
    farther = gain * (even_share - sorensen.min())
    for r in range(len(distance)):
        distance[r] += farther * is_virtual[r]
    row = _nearest(distance, k)
    return row, distance[row], sorensen[row]


@njit(cache=True)
def _nearest(distance: FloatArray, k: int) -> IntArray:  # pragma: no cover - compiled
    """Return the k rows of least distance, nearest first; of equal ones the first."""
    if k > MANY:
        return np.argsort(distance, kind="mergesort")[:k]
    nearest, least = np.zeros(k, np.int64), np.full(k, np.inf)
    for r in range(len(distance)):
        if distance[r] < least[k - 1]:
            i = k - 1
            while i > 0 and least[i - 1] > distance[r]:
                nearest[i], least[i] = nearest[i - 1], least[i - 1]
                i -= 1
            nearest[i], least[i] = r, distance[r]
    return nearest


# Where nothing is divided by zero anyway, not being asked lets the loops run four rows at a time.
@njit(cache=True, error_model="numpy")
def _distances(
    inverted: tuple[IntArray, npt.NDArray[np.uint32]],
    levels: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    wifi: tuple[IntArray, FloatArray, FloatArray],
    ble: tuple[IntArray, FloatArray, float],
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """Return distance and Sørensen distance of every row (rows,)."""
    share, power, share_sum, power_norm = levels
    rows = len(power_norm)
    distance, sorensen = np.zeros(rows), np.ones(rows)
    if len(ble[0]):
        shared, heard = (
            _shared(inverted, (share, share), (ble[0], ble[1], ble[1]), rows),
            ble[1].sum(),
        )
        for r in range(rows):
            total = heard + share_sum[1, r]
            sorensen[r] = 1.0 - 2.0 * shared[r, 0] / total if total > 0.0 else 1.0
            distance[r] = ble[2] * sorensen[r]
    heard, length = wifi[1].sum(), math.sqrt((wifi[2] * wifi[2]).sum())
    if heard == 0.0:
        return sorensen.copy(), sorensen
    shared = _shared(inverted, (share, power), wifi, rows)
    for r in range(rows):
        sorensen[r] = 1.0 - 2.0 * shared[r, 0] / (heard + share_sum[0, r])
        lengths = length * power_norm[r]
        cosine = 1.0 - shared[r, 1] / lengths if lengths > 0.0 else 1.0
        distance[r] += sorensen[r] + cosine
    return distance, sorensen


@njit(cache=True)
def _shared(
    inverted: tuple[IntArray, npt.NDArray[np.uint32]],
    levels: tuple[FloatArray, FloatArray],
    heard: tuple[IntArray, FloatArray, FloatArray],
    rows: int,
) -> FloatArray:  # pragma: no cover - compiled
    """Return Σ min(a, b) and a·b of every row (rows, 2) over the access points heard.

    Nearly all of a match's time goes by here: an access point's entries are taken as slices, and
    both sums of a row lie side by side.
    """
    sums = np.zeros((rows, 2))
    for i in range(len(heard[0])):
        access_point, share, power = heard[0][i], heard[1][i], heard[2][i]
        if access_point < 0:
            continue
        begin, end = inverted[0][access_point], inverted[0][access_point + 1]
        row, shares, powers = inverted[1][begin:end], levels[0][begin:end], levels[1][begin:end]
        for entry in range(len(row)):
            r = row[entry]
            sums[r, 0] += min(shares[entry], share)
            sums[r, 1] += power * powers[entry]
    return sums
