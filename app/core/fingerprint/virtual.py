"""Virtual fingerprints: what a phone would hear on walkable floor that the survey missed.

Most of the error of a fingerprint system lies in the holes of its map (on ms2020 truth farther than
8 m from any survey scan has three times the error of truth within 2 m). So walkable cells between
``min_distance_m`` and ``max_distance_m`` from the survey get a fingerprint of their own, per
transmitter t heard by at least ``min_scans`` scans of the floor:

    level(x) = c_t - g_t log10 |x - p_t| + r_t(x)

p_t the level-weighted centroid of where it was heard (a place for it, not the place), c_t and g_t
by ridge regression, r_t(x) the residuals of the scans around x, weighted by a Gaussian kernel and
shrunk. Where less than ``heard_share`` of the scans around x heard t, it is silent.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from app.core.fingerprint.radio_map import WIFI, Fingerprint, RadioMap
from app.core.params import VirtualParams
from app.core.types import BoolArray, FloatArray, IntArray

VIRTUAL_WALK = "virtual"
"""Survey walk that virtual fingerprints name: they were not walked."""


@dataclass(frozen=True, slots=True, eq=False)
class _Heard:
    """Levels of a floor's scans (rows) by transmitter (columns); 0 where not heard."""

    places: FloatArray
    transmitters: IntArray
    level_dbm: FloatArray
    heard: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Trend:
    """Per transmitter: place (t, 2), level at 1 m and loss per decade, and the scans' residuals."""

    places: FloatArray
    level_dbm: FloatArray
    loss_db: FloatArray
    residual_db: FloatArray

    def at(self, places: FloatArray) -> FloatArray:
        """Return the levels of the trend alone at places (n, 2)."""
        return self.level_dbm - self.loss_db * _log_distance(places, self.places)


def virtual_fingerprints(
    radio_map: RadioMap, floor_index: int, cells: FloatArray, params: VirtualParams
) -> list[Fingerprint]:
    """Return virtual fingerprints of one floor.

    Parameters
    ----------
    cells : (n, 2)
        Walkable places of the floor, site frame.
    """
    rows = np.flatnonzero(radio_map.floor_index == floor_index)
    if not len(rows) or not len(cells):
        return []
    heard = _heard_on(radio_map, rows, params.min_scans)
    distance_m = cKDTree(heard.places).query(cells)[0]
    cells = cells[(distance_m >= params.min_distance_m) & (distance_m <= params.max_distance_m)]
    if not len(cells) or not len(heard.transmitters):
        return []
    trend = _trend(heard, params)
    apart_m2 = np.square(cells[:, None, :] - heard.places[None]).sum(axis=2)
    kernel = np.exp(-0.5 * apart_m2 / params.kernel_m**2)
    near = kernel @ heard.heard
    share = near / np.maximum(kernel.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    level_dbm = trend.at(cells) + kernel @ trend.residual_db / (near + params.shrinkage)
    audible = (share >= params.heard_share) & (level_dbm > params.floor_dbm)
    return [
        _fingerprint(
            radio_map, floor_index, cells[i], heard.transmitters[sounds], level_dbm[i, sounds]
        )
        for i, sounds in enumerate(audible)
        if np.count_nonzero(sounds) >= params.min_transmitters
    ]


def _heard_on(radio_map: RadioMap, rows: IntArray, min_scans: int) -> _Heard:
    position = np.full(radio_map.rows, -1)
    position[rows] = np.arange(len(rows))
    entry_row = position[np.repeat(np.arange(radio_map.rows), np.diff(radio_map.row_start))]
    here = entry_row >= 0
    column = radio_map.column[here]
    counts = np.bincount(column, minlength=len(radio_map.transmitters))
    transmitters = np.flatnonzero(counts >= min_scans)
    index = np.full(len(radio_map.transmitters), -1)
    index[transmitters] = np.arange(len(transmitters))
    often = index[column] >= 0
    place = (entry_row[here][often], index[column[often]])
    level_dbm = np.zeros((len(rows), len(transmitters)))
    heard = np.zeros_like(level_dbm, dtype=np.bool_)
    level_dbm[place], heard[place] = radio_map.rssi_dbm[here][often], True
    places = np.column_stack([radio_map.x_m[rows], radio_map.y_m[rows]])
    return _Heard(places, transmitters, level_dbm, heard)


def _trend(heard: _Heard, params: VirtualParams) -> _Trend:
    # Amplitude, not power: the one strongest scan would otherwise be the place.
    amplitude = np.where(heard.heard, 10.0 ** (heard.level_dbm / 20.0), 0.0)
    places = (amplitude.T @ heard.places) / amplitude.sum(axis=0)[:, None]
    count = heard.heard.sum(axis=0)
    log_m = _log_distance(heard.places, places)
    mean_log = (log_m * heard.heard).sum(axis=0) / count
    mean_dbm = heard.level_dbm.sum(axis=0) / count
    off_log = (log_m - mean_log) * heard.heard
    covariance = (off_log * (heard.level_dbm - mean_dbm)).sum(axis=0)
    slope = (params.ridge * params.usual_loss_db - covariance) / (
        np.square(off_log).sum(axis=0) + params.ridge
    )
    loss_db = np.clip(slope, params.min_loss_db, params.max_loss_db)
    level_dbm = mean_dbm + loss_db * mean_log
    residual_db = np.where(heard.heard, heard.level_dbm - level_dbm + loss_db * log_m, 0.0)
    return _Trend(places, level_dbm, loss_db, residual_db)


def _log_distance(places: FloatArray, transmitters: FloatArray) -> FloatArray:
    apart_m = np.linalg.norm(places[:, None, :] - transmitters[None], axis=2)
    return np.asarray(np.log10(np.maximum(apart_m, 1.0)))


def _fingerprint(
    radio_map: RadioMap,
    floor_index: int,
    cell: FloatArray,
    columns: IntArray,
    level_dbm: FloatArray,
) -> Fingerprint:
    wifi_dbm: dict[str, float] = {}
    ble_dbm: dict[str, float] = {}
    for column, level in zip(columns.tolist(), level_dbm.tolist(), strict=True):
        levels = wifi_dbm if radio_map.radio[column] == WIFI else ble_dbm
        levels[radio_map.transmitters[column]] = level
    return Fingerprint(floor_index, float(cell[0]), float(cell[1]), wifi_dbm, ble_dbm, VIRTUAL_WALK)
