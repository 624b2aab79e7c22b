"""Contradiction: what a scan says against a transmitter being where the radio map knows it.

A scan resembles some fingerprints (weights w_r), and they say what ought to be heard there: of
transmitter t, the presence p = Σ_r w_r over those that hear it, and their mean level. Where p = 0,
the distance d from the scan's fix to the nearest fingerprint that hears t says how far off it would
be. A scan that hears t, or should (p > 0), adds the log-likelihood ratio of "t is elsewhere now"
against "as mapped":

    heard:      ln f1(c) - ln f0(c)      c: class of p and of the level's deviation, or of d
    not heard:  -ln P(silent | c')       c': class of p and of the level expected

f0 and P are how often surveyed scans fall into each class when matched without their own walk; f1
is the same with the transmitters that they hear named anew, all of the map's in turn: a
transmitter put elsewhere is heard where that has nothing to do with what the map says. So a
building with wild levels or few walks makes weak evidence by itself. (Neyman and Pearson 1933, on
distributions learned of the map.)
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.leaving_out import (
    left_out_matches,
    single_fix,
    walk_numbers,
)
from app.core.fingerprint.matching import Matches
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.core.types import BoolArray, FloatArray, IntArray

# Upper bounds of classes, the last one open. ms2020 (folds 1 to 3) is indifferent to finer ones; of
# less data than ms2020's, finer ones would learn noise.
_PRESENCE = np.array([0.25, 0.5, 0.75])
_DEVIATION_DB = np.array([5.0, 10.0, 15.0])
_APART_M = np.array([5.0, 10.0, 20.0, 40.0])
_EXPECTED_DBM = np.array([-88.0, -75.0])

_PRESENCES = len(_PRESENCE) + 1
_DEVIATIONS = len(_DEVIATION_DB) + 1
_EXPECTATIONS = len(_EXPECTED_DBM) + 1

FLOOR_APART_M = 15.0
"""What one floor counts in distances: as good as out of a room's reach, short of out of earshot."""

NO_WALK = -1
"""The walk of a scan that is of no survey."""


@dataclass(frozen=True, slots=True, eq=False)
class Hearing:
    """What one scan and the fingerprints that it resembles say of transmitters (n,) of the map.

    Attributes
    ----------
    column
        Those that the scan hears or that are expected.
    is_heard, level_dbm
        Whether it hears them, and at what level; nan where not.
    presence, expected_dbm
        p, and the mean level where that is not 0, else nan.
    apart_m
        d where a transmitter is heard and p = 0, inf if no fingerprint hears it; else 0.
    floor_index, x_m, y_m
        The scan's single fix.
    """

    column: IntArray
    is_heard: BoolArray
    level_dbm: FloatArray
    presence: FloatArray
    expected_dbm: FloatArray
    apart_m: FloatArray
    floor_index: int
    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Log-likelihood ratios (classes,) of scans that hear a transmitter, and that miss it."""

    heard: FloatArray
    silent: FloatArray

    def of(self, scan: Hearing) -> FloatArray:
        """Return what a scan says against each of its transmitters (n,), in nats."""
        return np.where(
            scan.is_heard,
            self.heard[_heard_class(scan.presence, _deviation_db(scan), scan.apart_m)],
            self.silent[_silent_class(scan)],
        )


def hearings(
    matched: Iterable[tuple[Query, Matches | None]], radio_map: RadioMap
) -> Iterator[Hearing | None]:
    """Yield what scans and the rows that they resemble say; None of those that match nothing."""
    walk = np.full(radio_map.rows, NO_WALK - 1, dtype=np.int64)
    for query, matches in matched:
        if matches is None:
            yield None
            continue
        levels_dbm = _levels_dbm(query, radio_map)
        heard = np.flatnonzero(~np.isnan(levels_dbm))
        yield _hearing(levels_dbm, heard, matches, _Places(radio_map, walk, NO_WALK))


def learned_weights(radio_map: RadioMap, matching: MatchParams) -> Weights:
    """Return what scans say, learned of the survey alone; it changes with the map only."""
    surveyed = radio_map.of_rows(is_surveyed(radio_map))
    walk = walk_numbers(surveyed)
    columns = len(surveyed.transmitters)
    as_mapped, elsewhere = (np.zeros(_PRESENCES * _DEVIATIONS + len(_APART_M) + 1) for _ in "01")
    silent, expected = (np.zeros(_PRESENCES * _EXPECTATIONS) for _ in "01")
    turn = 0
    for row, query, matches in left_out_matches(surveyed, matching):
        if matches is None:
            continue
        places = _Places(surveyed, walk, int(walk[row]))
        levels_dbm = _levels_dbm(query, surveyed)
        heard = np.flatnonzero(~np.isnan(levels_dbm))
        scan = _hearing(levels_dbm, heard, matches, places)
        _count(as_mapped, scan)
        np.add.at(expected, _silent_class(scan)[scan.presence > 0.0], 1.0)
        np.add.at(silent, _silent_class(scan)[~scan.is_heard], 1.0)
        # Consecutive columns, no two scans' alike: every transmitter stands in as often.
        strangers = (turn + np.arange(len(heard))) % columns
        turn += len(heard)
        strange_dbm = np.full(columns, np.nan)
        strange_dbm[strangers] = levels_dbm[heard]
        _count(elsewhere, _hearing(strange_dbm, strangers, matches, places))
    # One count more in each class: what was never seen is not impossible.
    return Weights(
        _log_share(elsewhere) - _log_share(as_mapped), -np.log((silent + 1) / (expected + 1))
    )


def _log_share(counts: FloatArray) -> FloatArray:
    return np.asarray(np.log((counts + 1.0) / (counts + 1.0).sum()))


def _count(counts: FloatArray, scan: Hearing) -> None:
    classes = _heard_class(scan.presence, _deviation_db(scan), scan.apart_m)
    np.add.at(counts, classes[scan.is_heard], 1.0)


def _deviation_db(scan: Hearing) -> FloatArray:
    return np.nan_to_num(np.abs(scan.level_dbm - scan.expected_dbm))


def _heard_class(presence: FloatArray, deviation_db: FloatArray, apart_m: FloatArray) -> IntArray:
    expected = np.searchsorted(_PRESENCE, presence) * _DEVIATIONS
    expected += np.searchsorted(_DEVIATION_DB, deviation_db)
    unexpected = _PRESENCES * _DEVIATIONS + np.searchsorted(_APART_M, apart_m)
    return np.where(presence > 0.0, expected, unexpected)


def _silent_class(scan: Hearing) -> IntArray:
    level = np.searchsorted(_EXPECTED_DBM, np.nan_to_num(scan.expected_dbm))
    return np.asarray(np.searchsorted(_PRESENCE, scan.presence) * _EXPECTATIONS + level)


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where transmitters are heard: the walks (rows,) of the map's rows, and the one left out."""

    radio_map: RadioMap
    walk: IntArray
    without: int


def _levels_dbm(query: Query, radio_map: RadioMap) -> FloatArray:
    levels_dbm = np.full(len(radio_map.transmitters), np.nan)
    for levels in (query.wifi_dbm, query.ble_dbm):
        for key, level_dbm in levels.items():
            column = radio_map.column_by_key.get(key)
            if column is not None:
                levels_dbm[column] = level_dbm
    return levels_dbm


def _hearing(levels_dbm: FloatArray, heard: IntArray, matches: Matches, places: _Places) -> Hearing:
    radio_map = places.radio_map
    start, end = radio_map.row_start[matches.row], radio_map.row_start[matches.row + 1]
    entries = np.concatenate([np.arange(a, b) for a, b in zip(start, end, strict=True)])
    weight = np.repeat(matches.weight, end - start)
    at, columns = radio_map.column[entries], len(radio_map.transmitters)
    presence = np.bincount(at, weight, columns).astype(np.float64)
    level_sum_dbm = np.bincount(at, weight * radio_map.rssi_dbm[entries], columns)
    column = np.union1d(heard, np.flatnonzero(presence > 0.0))
    presence = presence[column]
    is_heard = ~np.isnan(levels_dbm[column])
    unexpected = is_heard & (presence == 0.0)
    fix = single_fix(matches)
    apart_m = np.zeros(len(column))
    apart_m[unexpected] = _apart_m(
        column[unexpected],
        (radio_map.column_start, radio_map.row),
        (radio_map.x_m, radio_map.y_m, radio_map.floor_index, places.walk),
        (fix.x_m, fix.y_m, fix.floor_index, places.without),
    )
    expected_dbm = np.full(len(column), np.nan)
    np.divide(level_sum_dbm[column], presence, out=expected_dbm, where=presence > 0.0)
    return Hearing(
        column=column,
        is_heard=is_heard,
        level_dbm=levels_dbm[column],
        presence=presence,
        expected_dbm=expected_dbm,
        apart_m=apart_m,
        floor_index=fix.floor_index,
        x_m=fix.x_m,
        y_m=fix.y_m,
    )


@njit(cache=True)
def _apart_m(
    columns: IntArray,
    inverted: tuple[IntArray, IntArray],
    rows: tuple[FloatArray, FloatArray, IntArray, IntArray],
    asked: tuple[float, float, int, int],
) -> FloatArray:  # pragma: no cover - compiled
    column_start, row = inverted
    x_m, y_m, floor_index, walk = rows
    asked_x_m, asked_y_m, asked_floor, without = asked
    apart_m2 = np.full(len(columns), np.inf)
    for i in range(len(columns)):
        for entry in range(column_start[columns[i]], column_start[columns[i] + 1]):
            r = row[entry]
            if walk[r] != without:
                up_m = FLOOR_APART_M * (floor_index[r] - asked_floor)
                m2 = (x_m[r] - asked_x_m) ** 2 + (y_m[r] - asked_y_m) ** 2 + up_m**2
                apart_m2[i] = min(apart_m2[i], m2)
    apart_m: FloatArray = np.sqrt(apart_m2)
    return apart_m
