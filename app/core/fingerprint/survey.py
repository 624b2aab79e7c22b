"""From surveyed walks to fingerprints, each at the place where it was reported.

A walk with Wi-Fi gives one per Wi-Fi scan, with the beacons of the seconds before. A walk of a
phone that cannot scan Wi-Fi (an iPhone) gives one a second of beacons alone.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator

from app.core.fingerprint.query import (
    Advertisement,
    KeyChoice,
    fresh_wifi_dbm,
    hear,
    mean_ble_dbm,
    within,
)
from app.core.fingerprint.radio_map import Fingerprint
from app.core.params import MatchParams
from app.core.types import BleScan, Observation, WifiScan

Place = tuple[float, float]

BEACONS_EVERY_S = 1.0
"""At walking pace 1.2 m apart; phones report their advertisements about once a second."""


def walk_fingerprints(
    observations: Iterable[Observation],
    place_at: Callable[[float], Place | None],
    floor_index: int,
    walk: str,
    rule: tuple[KeyChoice, MatchParams],
) -> Iterator[Fingerprint]:
    """Yield a fingerprint for each Wi-Fi scan of a walk that can be placed.

    Parameters
    ----------
    observations
        In the order of the fold.
    place_at
        Where the surveyor was at a time, in the site frame; None where that is not known.
    rule
        How a transmitter is named (`chosen_keys`), and the parameters that queries are built with:
        map and queries must be built alike.
    """
    for time_s, wifi_dbm, ble_dbm in scan_levels(observations, rule):
        place = place_at(time_s)
        if place is not None:
            yield Fingerprint(floor_index, *place, wifi_dbm, ble_dbm, walk, time_s)


def beacon_walk_fingerprints(
    observations: Iterable[Observation],
    place_at: Callable[[float], Place | None],
    floor_index: int,
    walk: str,
    rule: tuple[KeyChoice, MatchParams],
) -> Iterator[Fingerprint]:
    """Yield the fingerprints of a walk without Wi-Fi; see above."""
    for time_s, ble_dbm in beacon_levels(observations, rule):
        place = place_at(time_s)
        if place is not None:
            yield Fingerprint(floor_index, *place, {}, ble_dbm, walk, time_s)


def has_wifi(observations: Iterable[Observation]) -> bool:
    """Return whether a phone scanned Wi-Fi at all."""
    return any(isinstance(observation, WifiScan) for observation in observations)


def beacon_levels(
    observations: Iterable[Observation], rule: tuple[KeyChoice, MatchParams]
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield time and mean levels of the last ``ble_window_s``, every `BEACONS_EVERY_S` at most.

    The window is the live matcher's for phones without Wi-Fi, so that map and query lag alike.
    """
    choose, params = rule
    heard: tuple[Advertisement, ...] = ()
    next_s = -math.inf
    for observation in observations:
        if not isinstance(observation, BleScan):
            continue
        heard = hear(heard, observation, params.ble_window_s)
        if observation.time_s < next_s:
            continue
        ble_dbm = mean_ble_dbm(heard, choose)
        if len(ble_dbm) >= params.min_readings:
            next_s = observation.time_s + BEACONS_EVERY_S
            yield observation.time_s, ble_dbm


def scan_levels(
    observations: Iterable[Observation], rule: tuple[KeyChoice, MatchParams]
) -> Iterator[tuple[float, dict[str, float], dict[str, float]]]:
    """Yield time, Wi-Fi and BLE levels of each Wi-Fi scan that says enough; see above."""
    choose, params = rule
    heard: tuple[Advertisement, ...] = ()
    for observation in observations:
        if isinstance(observation, BleScan):
            heard = hear(heard, observation, params.ble_window_s)
        elif isinstance(observation, WifiScan):
            wifi_dbm = fresh_wifi_dbm(observation, params.max_age_s, choose)
            if len(wifi_dbm) >= params.min_readings:
                recent = within(heard, observation.time_s, params.ble_window_s)
                yield observation.time_s, wifi_dbm, mean_ble_dbm(recent, choose)


def chosen_keys(observations: Iterable[Observation]) -> KeyChoice:
    """Return the rule that names each transmitter of a survey.

    A beacon identity that a single MAC uses names its transmitter (every phone sees it, iPhones
    see nothing else); one that several MACs share (80 % of the rows of ms2020 have the same UUID
    and 0/0) cannot, there the MAC does.
    """
    macs: dict[str, set[str]] = defaultdict(set)
    for observation in observations:
        if isinstance(observation, BleScan):
            for reading in observation.readings:
                macs[reading.keys[0]].add(reading.keys[-1])
    return lambda keys: keys[0] if len(macs.get(keys[0], ())) <= 1 else keys[-1]
