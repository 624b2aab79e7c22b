"""The same recordings as other phones would have posted them: less scanned, or heard otherwise."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from app.core.types import BleScan, Observation, WifiScan

Phone: TypeAlias = Callable[[Sequence[Observation]], tuple[Observation, ...]]

THROTTLED_PERIOD_S = 30.0
"""Android 9 and later lets an app in the foreground scan Wi-Fi four times in two minutes."""

OFFSET_DB = 10.0
"""About as far as phones are apart."""


def _recorded(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    return tuple(observations)


def _iphone(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """Leave Wi-Fi out: iOS shows apps no scans."""
    return tuple(o for o in observations if not isinstance(o, WifiScan))


def _throttled(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    kept: list[Observation] = []
    last_s: float | None = None
    for observation in observations:
        if isinstance(observation, WifiScan):
            if last_s is not None and observation.time_s - last_s < THROTTLED_PERIOD_S:
                continue
            last_s = observation.time_s
        kept.append(observation)
    return tuple(kept)


def _hearing(offset_db: float) -> Phone:
    def changed(observations: Sequence[Observation]) -> tuple[Observation, ...]:
        return tuple(
            _offset(o, offset_db) if isinstance(o, WifiScan | BleScan) else o for o in observations
        )

    return changed


def _offset(scan: WifiScan | BleScan, offset_db: float) -> WifiScan | BleScan:
    readings = tuple(replace(r, rssi_dbm=r.rssi_dbm + offset_db) for r in scan.readings)
    return replace(scan, readings=readings)


PHONES: Mapping[str, Phone] = {
    "recorded": _recorded,
    "iphone": _iphone,
    "throttled": _throttled,
    "louder": _hearing(OFFSET_DB),
    "weaker": _hearing(-OFFSET_DB),
}
"""Every phone by its name; louder and weaker are 10 dB off, of which the engine is not told."""
