"""From surveyed walks to fingerprints: one per Wi-Fi scan, at the place where it was reported."""

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
