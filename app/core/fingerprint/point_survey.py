"""Fingerprints of a point survey: all scans at one reference point become one, cleaned.

Where a surveyor stood for several scans, the level of each transmitter is cleaned
(`app.core.fingerprint.cleaning`), and its deviation, the levels heard and the share of the scans
that heard it are kept beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from app.core.fingerprint.cleaning import CleaningParams, LevelStatistics, clean_levels
from app.core.fingerprint.radio_map import Fingerprint, RadioMap
from app.core.fingerprint.virtual import VIRTUAL_WALK

Scatter: TypeAlias = dict[str, tuple[float, int, float]]
"""Deviation (dB), count and share heard of each transmitter at one reference point."""

_SAME_PLACE_M = 0.01


@dataclass(frozen=True, slots=True)
class CleanedPoint:
    """A reference point: its one fingerprint, and the scatter of its levels."""

    fingerprint: Fingerprint
    scatter: Scatter


def cleaned_points(scans: Sequence[Fingerprint], params: CleaningParams) -> list[CleanedPoint]:
    """Return one fingerprint for each place and walk of the scans, in the order they came."""
    points: dict[tuple[int, int, int, str], list[Fingerprint]] = {}
    for scan in scans:
        x, y = round(scan.x_m / _SAME_PLACE_M), round(scan.y_m / _SAME_PLACE_M)
        points.setdefault((scan.floor_index, x, y, scan.survey_walk), []).append(scan)
    return [_cleaned(of_point, params) for of_point in points.values()]


def _cleaned(scans: list[Fingerprint], params: CleaningParams) -> CleanedPoint:
    wifi_dbm, wifi = _clean([scan.wifi_dbm for scan in scans], params)
    ble_dbm, ble = _clean([scan.ble_dbm for scan in scans], params)
    fingerprint = replace(scans[0], wifi_dbm=wifi_dbm, ble_dbm=ble_dbm)
    return CleanedPoint(fingerprint, wifi | ble)


def _clean(
    scans: list[dict[str, float]], params: CleaningParams
) -> tuple[dict[str, float], Scatter]:
    number: dict[str, int] = {}
    heard = [
        (number.setdefault(key, len(number)), level_dbm)
        for scan in scans
        for key, level_dbm in scan.items()
    ]
    if not heard:
        return {}, {}
    transmitter = np.array([index for index, _ in heard], dtype=np.int64)
    levels = clean_levels(
        np.zeros_like(transmitter),
        transmitter,
        np.array([level_dbm for _, level_dbm in heard], dtype=np.float64),
        np.array([len(scans)], dtype=np.int64),
        params,
    )
    # By transmitter in ascending order: the order of `number`.
    mean_dbm = dict(zip(number, levels.mean_dbm.tolist(), strict=True))
    columns = (levels.deviation_db, levels.count, levels.heard_share)
    scatter = zip(*(column.tolist() for column in columns), strict=True)
    return mean_dbm, dict(zip(number, scatter, strict=True))


def level_statistics(radio_map: RadioMap, scatter: dict[int, Scatter]) -> LevelStatistics:
    """Return the scatter of every level of a map.

    Parameters
    ----------
    scatter
        By row, of rows that are reference points. Other surveyed rows are single scans.
    """
    entries = len(radio_map.column)
    virtual = np.array([walk == VIRTUAL_WALK for walk in radio_map.survey_walks], dtype=np.bool_)
    heard = np.repeat(~virtual, np.diff(radio_map.row_start)).astype(np.float64)
    deviation_db, count, heard_share = np.zeros(entries), heard.astype(np.int64), heard
    for row, of_row in scatter.items():
        for entry in range(radio_map.row_start[row], radio_map.row_start[row + 1]):
            key = radio_map.transmitters[radio_map.column[entry]]
            deviation_db[entry], count[entry], heard_share[entry] = of_row[key]
    return LevelStatistics(deviation_db, count, heard_share)
