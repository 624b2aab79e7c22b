"""A radio map asked about itself: each surveyed scan matched as if its own walk were not there."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.match_index import match_index
from app.core.fingerprint.matching import Matches, likeness, match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import WIFI, Fingerprint, RadioMap
from app.core.params import MatchParams
from app.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class SingleFix:
    """What one scan alone says of the place.

    Attributes
    ----------
    floor_index, x_m, y_m
        Floor of most weight, and the weighted mean of the candidates on it.
    spread_m
        Root of the candidates' weighted mean square distance from that place.
    floor_share
        Weight of the candidates on that floor.
    """

    floor_index: int
    x_m: float
    y_m: float
    spread_m: float
    floor_share: float


def single_fix(matches: Matches) -> SingleFix:
    """Return the place that the candidates of one scan agree on."""
    votes = np.bincount(matches.floor_index, matches.weight)
    floor_index = int(np.argmax(votes))
    here = matches.floor_index == floor_index
    weight = matches.weight[here] / votes[floor_index]
    x_m, y_m = float(weight @ matches.x_m[here]), float(weight @ matches.y_m[here])
    apart_m2 = (matches.x_m[here] - x_m) ** 2 + (matches.y_m[here] - y_m) ** 2
    return SingleFix(
        floor_index, x_m, y_m, float(np.sqrt(weight @ apart_m2)), float(votes[floor_index])
    )


def query_of(radio_map: RadioMap, row: int) -> Query:
    """Return what was heard at a row."""
    wifi_dbm: dict[str, float] = {}
    ble_dbm: dict[str, float] = {}
    for entry in range(radio_map.row_start[row], radio_map.row_start[row + 1]):
        column = radio_map.column[entry]
        levels = wifi_dbm if radio_map.radio[column] == WIFI else ble_dbm
        levels[radio_map.transmitters[column]] = float(radio_map.rssi_dbm[entry])
    return Query(wifi_dbm, ble_dbm)


def fingerprints_of(radio_map: RadioMap) -> Iterator[Fingerprint]:
    """Yield the rows of a map as fingerprints; when they were taken it does not know."""
    for row in range(radio_map.rows):
        heard = query_of(radio_map, row)
        yield Fingerprint(
            int(radio_map.floor_index[row]),
            float(radio_map.x_m[row]),
            float(radio_map.y_m[row]),
            heard.wifi_dbm,
            heard.ble_dbm,
            radio_map.survey_walks[row],
        )


def walk_numbers(radio_map: RadioMap) -> IntArray:
    """Return the number of each row's survey walk (rows,), in the order of their first rows."""
    names = {name: i for i, name in enumerate(dict.fromkeys(radio_map.survey_walks))}
    return np.array([names[name] for name in radio_map.survey_walks], dtype=np.int64)


def left_out_matches(
    radio_map: RadioMap, params: MatchParams, most: int | None = None
) -> Iterator[tuple[int, Query, Matches | None]]:
    """Yield each surveyed row, its query, and what of the other walks' rows it resembles.

    Of more than ``most`` rows every other one, or every third and so on, is asked.

    The matcher is asked for as many candidates more as the longest walk has rows, and the walk's
    own are dropped: what a map without that walk would answer, but that the walk's rows still count
    where the matcher divides weight among the rows of one place. None where no other walk
    heard any of it. Grown rows are matched with, but not asked: nobody knows where they truly are.
    Take virtual rows out of ``radio_map`` first: they are made of all walks.
    """
    walk = walk_numbers(radio_map)
    surveyed = np.flatnonzero(is_surveyed(radio_map))
    longest = int(np.bincount(walk[surveyed]).max()) if len(surveyed) else 0
    wider = replace(params, k=params.k + longest)
    crowd = match_index(radio_map, wider).crowd
    step = 1 if most is None else max(math.ceil(len(surveyed) / most), 1)
    for row in surveyed[::step].tolist():
        query = query_of(radio_map, row)
        matches = match(query, radio_map, wider)
        own = walk == walk[row]
        yield row, query, None if matches is None else _of_others(matches, (own, crowd), params)


def _of_others(
    matches: Matches, rows: tuple[BoolArray, FloatArray], params: MatchParams
) -> Matches | None:
    own, crowd = rows
    other = np.flatnonzero(~own[matches.row])[: params.k]
    if not len(other) or matches.sorensen[other].min() >= 1.0:
        return None
    weight = likeness(matches.distance[other], matches.sorensen[other], params)
    weight /= crowd[matches.row[other]]
    return Matches(
        row=matches.row[other],
        distance=matches.distance[other],
        weight=weight / weight.sum(),
        floor_index=matches.floor_index[other],
        x_m=matches.x_m[other],
        y_m=matches.y_m[other],
        sorensen=matches.sorensen[other],
    )
