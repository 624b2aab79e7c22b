"""The published system zhu2018: fingerprint fixes and a pedometer, for people who go their rounds.

A fix is the weighted mean of the matched fingerprints on the floor that is believed in; strides and
fixes go through the Kalman filter of `app.core.fusion.scheduled`.

Source: Zhu, Wang, Chen, Fang, Zhang, "Fusion location algorithm based on Bluetooth and pedometer",
Packaging Engineering 39(5), 2018.
"""

from dataclasses import dataclass, field

import numpy as np

from app.core.changed import changed
from app.core.engine.fixing import without
from app.core.engine.state import SessionState, Stride
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.scheduled import ScheduledMemory, ScheduledParams, Vector, begin, update, walk
from app.core.fusion.sighting import Sighting
from app.core.params import LevelOffsetParams, MatchParams, Params, ReportParams, SmootherParams
from app.core.site import SiteModel
from app.core.types import BleScan, Method, NoFixReason, WifiScan


def _published_match() -> MatchParams:
    """Return what makes a fix of each second, of its own advertisements: older ones lag behind.

    Where a phone scans Wi-Fi it does so every 2 to 4 s; after that BLE does without.
    """
    return MatchParams(ble_window_s=1.0, wifi_gap_s=4.0, wifi_start_s=4.0)


def _published_report() -> ReportParams:
    """Return what makes P a covariance: it is of the schedule's scale, some 200 times too wide.

    Fitted on the tuning walks of ms2020: 95 % of the truth within ``radius95_m``, in every decile
    of the radius over 85 %. Without fixes it grows as the published filter's own P would, by
    ``process_m2ps`` of that scale; with the scans of 17 of those walks cut off, errors grow by
    9 m²/s in the first half minute, then hardly.
    """
    scale = 0.005
    unfixed_m2ps = scale * ScheduledParams().process_m2ps
    return ReportParams(covariance_scale=scale, extra_variance_m2=24.0, unfixed_m2ps=unfixed_m2ps)


@dataclass(frozen=True, slots=True)
class Zhu2018Params(Params):
    """Parameters of zhu2018; see `ScheduledParams`."""

    profile: str = "zhu2018"
    match: MatchParams = field(default_factory=_published_match)
    level_offset: LevelOffsetParams | None = None
    report: ReportParams = field(default_factory=_published_report)
    smoother: SmootherParams | None = None
    scheduled: ScheduledParams = field(default_factory=ScheduledParams)


def walk_scheduled(
    state: SessionState, stride: Stride, site: SiteModel, params: Zhu2018Params
) -> SessionState:
    """Move the filter by a stride; before the first fix there is none."""
    _ = site
    if not isinstance(state.track, PlanarTrack) or not isinstance(state.memory, ScheduledMemory):
        return state
    step = (stride.time_s, stride.length_m, stride.heading_rad)
    track, memory = walk(state.track, state.memory, step, params.scheduled)
    return changed(state, track=track, memory=memory)


def correct_scheduled(
    state: SessionState, scan: BleScan | WifiScan, site: SiteModel, params: Zhu2018Params
) -> SessionState:
    """Correct the filter by the scan's fix, or begin it there."""
    if site.radio_map is None:
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    sighting = state.evidence.sighting
    if sighting is None or state.floor_belief is None:
        return state
    floor = int(np.argmax(state.floor_belief))
    fix_m = mean_place(sighting, floor, params.floor.vote_floor)
    if fix_m is None:
        return state
    state = changed(state, told_s=scan.time_s)
    if not isinstance(state.track, PlanarTrack) or not isinstance(state.memory, ScheduledMemory):
        track, memory = begin(fix_m, scan.time_s, params.scheduled)
        return changed(state, track=track, memory=memory, method=Method.FINGERPRINT)
    track, memory = update(state.track, state.memory, fix_m, scan.time_s, params.scheduled)
    return changed(state, track=track, memory=memory, method=Method.FUSED)


def mean_place(sighting: Sighting, floor_index: int, least_share: float) -> Vector | None:
    """Return the weighted mean of the candidates on a floor.

    None where they have less than this share of the weight: they only happen to look alike.
    """
    weight = sighting.weight
    if sighting.floor_index is not None:
        weight = weight * (sighting.floor_index == floor_index)
    total = float(weight.sum())
    if total < least_share * float(sighting.weight.sum()):
        return None
    x_m, y_m = weight @ sighting.places / total
    return float(x_m), float(y_m)
