"""The published system tao2016: smoothed levels against a cleaned radio map, and nothing else.

Every transmitter heard has a jump-adaptive filter; the levels they tell are compared with those of
reference points, cleaned of outliers, by weighted nearest neighbours, and the neighbours' mean is
the answer: there is no dead reckoning. Published for BLE; Wi-Fi, where a phone scans it, is treated
alike.

Source: Tao, Yang, Wang, Zhang, "Indoor fingerprint location optimization technology based on BLE",
Journal of Anhui Agricultural Sciences 44(8), 2016.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from app.core.changed import changed
from app.core.derived import derived
from app.core.engine.fixing import believe, sums, without
from app.core.engine.state import SessionState
from app.core.fingerprint.cleaning import CleaningParams, gauss_mean_dbm
from app.core.fingerprint.query import KeyChoice, first_of
from app.core.fingerprint.radio_map import BLE, WIFI, RadioMap
from app.core.fingerprint.reference_points import ReferencePointParams, reference_points
from app.core.fingerprint.wknn import (
    Neighbours,
    SignalSpace,
    WknnParams,
    mean_place,
    nearest,
    of_floor,
    signal_space,
)
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.params import LevelOffsetParams, Params, ReportParams, SmootherParams
from app.core.radio.level_smoothing import LevelMemory, LevelSmoothingParams, Measurement, listen
from app.core.site import SiteModel
from app.core.types import BleScan, FloatArray, Method, NoFixReason, Used, WifiScan


def _report() -> ReportParams:
    """Return what makes the scatter of the neighbours an error, from ms2020's tuning walks.

    Nothing carries the track while no fix comes, but its phone walks away from it: with the scans
    of 17 of those walks cut off, errors grow by 6 m²/s in half a minute and by 16 in a whole one.
    """
    return ReportParams(covariance_scale=1.0, extra_variance_m2=45.0, unfixed_m2ps=16.0)


@dataclass(frozen=True, slots=True)
class Tao2016Params(Params):
    """Parameters of tao2016.

    Attributes
    ----------
    smoothing, reference, wknn
        Of the blocks, as published where the paper prints them.
    hold_s
        A transmitter is heard with the level of its filter until it is silent for so long; longer
        than a phone's Wi-Fi scan takes (ms2020's tuning walks: 4 s is 18 % worse, 10 s 2 % better
        in the mean, 9 % worse in the median).
    min_transmitters
        With fewer the nearest point is anyone's guess.
    """

    profile: str = "tao2016"
    report: ReportParams = field(default_factory=_report)
    level_offset: LevelOffsetParams | None = None
    smoother: SmootherParams | None = None
    smoothing: LevelSmoothingParams = field(default_factory=LevelSmoothingParams)
    reference: ReferencePointParams = field(default_factory=ReferencePointParams)
    wknn: WknnParams = field(default_factory=WknnParams)
    hold_s: float = 6.0
    min_transmitters: int = 3


def smooth_levels(
    state: SessionState, scan: BleScan | WifiScan, site: SiteModel, params: Tao2016Params
) -> SessionState:
    """Feed a scan's levels to the filters of their transmitters."""
    known = {} if site.radio_map is None else site.radio_map.column_by_key
    memory = state.memory if isinstance(state.memory, LevelMemory) else LevelMemory({})
    cleaning = params.reference.cleaning
    measurements = _measurements(scan, first_of(known), cleaning)
    memory = listen(memory, measurements, scan.time_s, params.hold_s, params.smoothing)
    return changed(state, memory=memory)


def locate_by_wifi(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Tao2016Params
) -> SessionState:
    """Make the mean of the nearest reference points the track, by all that is heard."""
    state = changed(state, wifi_s=scan.time_s)
    return _locate(state, scan.time_s, (WIFI, BLE), site, params)


def locate_by_beacons(
    state: SessionState, scan: BleScan, site: SiteModel, params: Tao2016Params
) -> SessionState:
    """Do so by beacons alone, for phones that cannot scan Wi-Fi or do not just now."""
    began_s = scan.time_s if state.began_s is None else state.began_s
    since_s = began_s if state.wifi_s is None else state.wifi_s
    is_wifi_due = scan.time_s - since_s <= params.match.wifi_gap_s
    if is_wifi_due and site.radio_map is not None and WIFI in _radios(site.radio_map):
        return state
    return _locate(state, scan.time_s, (BLE,), site, params)


def _measurements(
    scan: BleScan | WifiScan, choose: KeyChoice, cleaning: CleaningParams
) -> Iterator[Measurement]:
    """Yield one level per transmitter of a scan, the Gauss-mean of its readings, at their last."""
    heard: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for reading in scan.readings:
        heard[choose(reading.keys)].append((scan.time_s - reading.age_s, reading.rssi_dbm))
    for key, readings in heard.items():
        time_s, level_dbm = max(readings)
        if len(readings) > 1:
            level_dbm = gauss_mean_dbm(np.array([level for _, level in readings]), cleaning)
        yield Measurement(key, time_s, level_dbm)


def _locate(
    state: SessionState,
    time_s: float,
    radios: tuple[int, ...],
    site: SiteModel,
    params: Tao2016Params,
) -> SessionState:
    radio_map = site.radio_map
    if radio_map is None:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    if not isinstance(state.memory, LevelMemory) or not state.memory.by_key:
        return without(state, NoFixReason.NOTHING_HEARD)
    levels_dbm = _known_levels_dbm(state.memory, radio_map, radios)
    if len(levels_dbm) < params.min_transmitters:
        few = NoFixReason.TOO_FEW_TRANSMITTERS if levels_dbm else NoFixReason.UNKNOWN_TRANSMITTERS
        return without(state, few)
    space = _space(radio_map, radios, params.reference, params.wknn)
    found = nearest(levels_dbm, space, params.wknn)
    if found is None:
        return without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    votes = sums(found.floor_index, found.weight, len(site.floors))
    belief = believe(state, votes, time_s, params)
    state = changed(state, floor_belief=belief)
    here = of_floor(found, int(np.argmax(belief)))
    if here is None:
        return state
    beacons = sum(int(radio_map.radio[column]) == BLE for column in levels_dbm)
    track = _track(here, params)
    return changed(
        state,
        track=track,
        evidence=changed(state.evidence, sighting=_sighting(found, time_s, track, votes)),
        told_s=time_s,
        method=Method.FINGERPRINT,
        used=Used(beacons=beacons, access_points=len(levels_dbm) - beacons),
    )


def _known_levels_dbm(
    memory: LevelMemory, radio_map: RadioMap, radios: tuple[int, ...]
) -> dict[int, float]:
    """Return the levels of the transmitters that the map knows, by column."""
    levels_dbm: dict[int, float] = {}
    for key, heard in memory.by_key.items():
        column = radio_map.column_by_key.get(key)
        if column is not None and int(radio_map.radio[column]) in radios:
            levels_dbm[column] = heard.smoothed.level_dbm
    return levels_dbm


def _track(neighbours: Neighbours, params: Tao2016Params) -> PlanarTrack:
    """Return the neighbours' mean and scatter; a reference point stands for all of its cell."""
    mean, scatter = mean_place(neighbours)
    return PlanarTrack(mean, scatter + np.eye(2) * params.reference.cell_m**2 / 12.0)


def _sighting(found: Neighbours, time_s: float, track: PlanarTrack, votes: FloatArray) -> Sighting:
    (xx, xy), (_, yy) = track.covariance.tolist()
    places = np.column_stack([found.x_m, found.y_m])
    return Sighting(time_s, places, found.weight, (xx, xy, yy), votes, found.floor_index)


@derived()
def _space(
    radio_map: RadioMap,
    radios: tuple[int, ...],
    reference: ReferencePointParams,
    wknn: WknnParams,
) -> SignalSpace:
    """Return the map's reference points as these radios hear them; computed once per map."""
    points = reference_points(radio_map, reference)
    levels = points.levels
    wanted = np.isin(radio_map.radio[levels.transmitter], radios)
    entries = (levels.point[wanted], levels.transmitter[wanted], levels.mean_dbm[wanted])
    places = (points.floor_index, points.x_m, points.y_m)
    return signal_space(places, entries, len(radio_map.transmitters), wknn)


@derived()
def _radios(radio_map: RadioMap) -> frozenset[int]:
    return frozenset(radio_map.radio.tolist())
