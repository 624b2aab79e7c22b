"""Levels heard at known places, from walks with waypoints, surveyed points or a plain list."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from app.core.radio.calibration import LabelledLevels
from app.core.radio.local_mean import local_means_dbm
from app.core.survey import Scan, Surveyed, SurveyWalk
from app.core.types import FloatArray

EPOCH_S = 2.0
"""A walker goes some 2 m in it, and a beacon is heard some ten times (as `LaterationParams`)."""

MAX_WIFI_AGE_S = 2.5
"""Phones repeat cached results: older ones were heard elsewhere (as `MatchParams.max_age_s`)."""

SAME_PLACE_M = 1.0
"""Levels of one phone nearer together than this are of one place: shadowing is the same."""

NameOf: TypeAlias = Callable[[tuple[str, ...]], str | None]
"""Which beacon a reading's keys are of; None: of none that counts."""


@dataclass(frozen=True, slots=True)
class LabelledEpoch:
    """What a phone heard within one window, at a place that is known: local means by beacon id.

    ``walk`` names the walk that it is of; empty: of none.
    """

    device_id: str
    x_m: float
    y_m: float
    rssi_dbm: dict[str, float]
    walk: str = ""


def by_registered_key(beacon_by_key: Mapping[str, str]) -> NameOf:
    """Return the rule that names registered beacons by the first of a reading's keys known."""
    return lambda keys: next((beacon_by_key[key] for key in keys if key in beacon_by_key), None)


def survey_epochs(
    records: Iterable[Surveyed], floor_id: str, device_id: str, name_of: NameOf
) -> Iterator[LabelledEpoch]:
    """Yield the epochs of a survey's walks and points on a floor."""
    for record in records:
        if record.floor_id != floor_id:
            continue
        if isinstance(record, SurveyWalk):
            of_walk = walk_epochs(record.scans, record.waypoints, device_id, name_of)
            yield from (replace(epoch, walk=record.walk) for epoch in of_walk)
            continue
        levels = {**record.wifi_dbm, **record.ble_dbm}
        named = [(name_of((key,)), level) for key, level in levels.items()]
        heard = {name: level for name, level in named if name is not None}
        if heard:
            yield LabelledEpoch(device_id, record.x_m, record.y_m, heard, record.walk)


def walk_epochs(
    scans: Iterable[Scan], waypoints: FloatArray, device_id: str, name_of: NameOf
) -> Iterator[LabelledEpoch]:
    """Yield the epochs of a walk, at the places on the straight lines between waypoints.

    Parameters
    ----------
    waypoints : (n, 3)
        Time (s), x and y (m, site frame), in time order. Nothing before the first and after the
        last is known.
    """
    windows: dict[int, list[tuple[float, str, float]]] = defaultdict(list)
    for scan in scans:
        for reading in scan.readings:
            time_s, name = scan.time_s - reading.age_s, name_of(reading.keys)
            is_known = len(waypoints) and waypoints[0, 0] <= time_s <= waypoints[-1, 0]
            if name is not None and is_known and reading.age_s <= MAX_WIFI_AGE_S:
                windows[int(time_s // EPOCH_S)].append((time_s, name, reading.rssi_dbm))
    for _, heard in sorted(windows.items()):
        mean_s = float(np.mean([time_s for time_s, _, _ in heard]))
        x_m, y_m = (float(np.interp(mean_s, waypoints[:, 0], waypoints[:, k])) for k in (1, 2))
        levels = local_means((name, level) for _, name, level in heard)
        yield LabelledEpoch(device_id, x_m, y_m, levels)


def local_means(heard: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the local mean of each beacon's levels."""
    names, levels = zip(*heard, strict=True)
    unique, group = np.unique(names, return_inverse=True)
    means = local_means_dbm(group, np.array(levels, dtype=np.float64), len(unique))
    return dict(zip(unique.tolist(), means.tolist(), strict=True))


def labelled_levels(
    epochs: Sequence[LabelledEpoch], beacon_ids: Sequence[str], device_ids: Sequence[str]
) -> LabelledLevels:
    """Return one level for each beacon, phone and place of `SAME_PLACE_M` by `SAME_PLACE_M`."""
    beacon = {beacon_id: i for i, beacon_id in enumerate(beacon_ids)}
    device = {device_id: i for i, device_id in enumerate(device_ids)}
    rows = np.array(
        [
            (beacon[name], device[e.device_id], e.x_m, e.y_m, level)
            for e in epochs
            for name, level in e.rssi_dbm.items()
            if name in beacon
        ],
        dtype=np.float64,
    ).reshape(-1, 5)
    cells = np.column_stack([rows[:, :2], np.floor(rows[:, 2:4] / SAME_PLACE_M)])
    unique, group = np.unique(cells, axis=0, return_inverse=True)
    group, count = group.reshape(-1), len(unique)
    share = np.maximum(np.bincount(group, minlength=count), 1)
    return LabelledLevels(
        unique[:, 0].astype(np.int64),
        unique[:, 1].astype(np.int64),
        np.bincount(group, rows[:, 2], count) / share,
        np.bincount(group, rows[:, 3], count) / share,
        local_means_dbm(group, rows[:, 4], count),
    )
