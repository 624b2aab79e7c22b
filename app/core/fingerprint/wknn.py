"""Weighted k nearest neighbours in signal space.

Equation
--------
With ``q_t`` the levels heard and ``r_pt`` those of reference point p, both ``m`` ("missing") for a
transmitter t that was not heard, and the sum over all transmitters that the map knows::

    d_p^2 = sum_t (q_t - r_pt)^2,    w_p = 1 / max(d_p, d_0)

over the k points with the smallest d. Transmitters unknown to the map are left out: they would add
the same to every distance.

All that both do not hear is zero, so only the pairs that both hear are gone through, by the map's
inverted index::

    d_p^2 = sum_t (q_t - m)^2 + sum_t (r_pt - m)^2 - 2 sum_t (q_t - m) (r_pt - m)

Source: Tao, Yang, Wang, Zhang, "Indoor fingerprint location optimization technology based on BLE",
Journal of Anhui Agricultural Sciences 44(8), 2016; the method is of Bahl and Padmanabhan, "RADAR",
INFOCOM 2000.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class WknnParams:
    """Parameters of the weighted k nearest neighbours.

    Attributes
    ----------
    k
        Neighbours that count.
    missing_dbm
        ``m``: level that stands for not heard, just under the weakest that phones report.
    least_distance_db
        ``d_0``: nearer is as good as equal, and weights stay finite; phones report whole decibels.
    """

    k: int = 4
    missing_dbm: float = -100.0
    least_distance_db: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SignalSpace:
    """Reference points as points in signal space, inverted: the points that hear a transmitter.

    Attributes
    ----------
    missing_dbm
        Level of a transmitter that a point does not hear.
    floor_index, x_m, y_m : (points,)
        Where each reference point is.
    column_start : (columns + 1,)
        Entries ``column_start[t]`` to ``column_start[t + 1]`` are of transmitter t.
    point : (entries,), over_missing_db : (entries,)
        Which point hears it, and how much louder than missing.
    square_norm_db2 : (points,)
        Sum of the squares of ``over_missing_db`` of each point.
    """

    missing_dbm: float
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    column_start: IntArray
    point: IntArray
    over_missing_db: FloatArray
    square_norm_db2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The nearest reference points of one query, nearest first.

    Attributes
    ----------
    point, distance_db, weight, floor_index, x_m, y_m : (k,)
        Which points, how far in signal space, weights (sum 1), and places.
    """

    point: IntArray
    distance_db: FloatArray
    weight: FloatArray
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray


def signal_space(
    places: tuple[IntArray, FloatArray, FloatArray],
    entries: tuple[IntArray, IntArray, FloatArray],
    columns: int,
    params: WknnParams,
) -> SignalSpace:
    """Return reference points in signal space.

    Parameters
    ----------
    places
        ``floor_index, x_m, y_m`` of each point, (points,) each.
    entries
        ``point, column, rssi_dbm`` of what the points hear, (entries,) each, in any order.
    columns
        Number of transmitters that the map knows.
    """
    point, column, rssi_dbm = entries
    order = np.lexsort((point, column))
    # A level under the missing one is no quieter than silence.
    over_db = np.maximum(rssi_dbm - params.missing_dbm, 0.0)
    return SignalSpace(
        params.missing_dbm,
        *places,
        column_start=np.searchsorted(column[order], np.arange(columns + 1)),
        point=point[order],
        over_missing_db=over_db[order],
        square_norm_db2=np.bincount(point, over_db**2, len(places[0])).astype(np.float64),
    )


def nearest(
    levels_dbm: Mapping[int, float], space: SignalSpace, params: WknnParams
) -> Neighbours | None:
    """Return the ``k`` nearest reference points; None if the map has none.

    Parameters
    ----------
    levels_dbm
        Level heard of each transmitter, by its column in the map.
    """
    if not len(space.x_m):
        return None
    # Sorted, so that sums do not depend on the order in which the phone listed them.
    items = sorted(levels_dbm.items())
    column = np.array([c for c, _ in items], dtype=np.int64)
    over_db = np.maximum(
        np.array([level for _, level in items], dtype=np.float64) - space.missing_dbm, 0.0
    )
    index = (space.column_start, space.point, space.over_missing_db)
    product = _products(index, column, over_db, len(space.x_m))
    square = float(over_db @ over_db) + space.square_norm_db2 - 2.0 * product
    distance_db = np.sqrt(np.maximum(square, 0.0))
    k = min(params.k, len(distance_db))
    # All that are as near as the k-th, so that of equals the first in the map is taken.
    point = np.flatnonzero(distance_db <= np.partition(distance_db, k - 1)[k - 1])
    point = point[np.argsort(distance_db[point], kind="stable")][:k]
    weight = 1.0 / np.maximum(distance_db[point], params.least_distance_db)
    return Neighbours(
        point=point,
        distance_db=distance_db[point],
        weight=weight / weight.sum(),
        floor_index=space.floor_index[point],
        x_m=space.x_m[point],
        y_m=space.y_m[point],
    )


def of_floor(neighbours: Neighbours, floor_index: int) -> Neighbours | None:
    """Return the neighbours on a floor, their weights sharing 1 anew; None if there are none."""
    here = neighbours.floor_index == floor_index
    if not here.any():
        return None
    weight = neighbours.weight[here]
    return Neighbours(
        point=neighbours.point[here],
        distance_db=neighbours.distance_db[here],
        weight=weight / weight.sum(),
        floor_index=neighbours.floor_index[here],
        x_m=neighbours.x_m[here],
        y_m=neighbours.y_m[here],
    )


def mean_place(neighbours: Neighbours) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean (2,) of the neighbours' places, and their scatter (2, 2) about it.

    The scatter is the estimate's own uncertainty: neighbours far apart say that the levels fit
    several places. It knows nothing of neighbours that are wrong together.
    """
    places = np.column_stack([neighbours.x_m, neighbours.y_m])
    mean = neighbours.weight @ places
    off_m = places - mean
    return mean, (off_m * neighbours.weight[:, None]).T @ off_m


@njit(cache=True)
def _products(
    index: tuple[IntArray, IntArray, FloatArray],
    column: IntArray,
    over_db: FloatArray,
    points: int,
) -> FloatArray:  # pragma: no cover - compiled
    column_start, point, over_missing_db = index
    product = np.zeros(points)
    for i in range(len(column)):
        for entry in range(column_start[column[i]], column_start[column[i] + 1]):
            product[point[entry]] += over_db[i] * over_missing_db[entry]
    return product
