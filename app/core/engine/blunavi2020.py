"""The published system blunavi2020: votes in rooms, an EKF on ranges in corridors, steps between.

Where a beacon is in line of sight its range corrects the extended Kalman filter; where none is in
range, or all are hidden, the reference point with the most votes does. Steps carry the filter.

Of its wish list the line-of-sight detector decides here, and fingerprints correct the dead
reckoning instead of replacing it. The hidden Markov model is `app.core.fingerprint.hmm`.

Source: Nguyen Ngoc Khuong, "BluNavi: an indoor positioning and navigation system", Haiphong
University Journal of Science 44, 2021.
"""

from dataclasses import dataclass, field

import numpy as np

from app.core.changed import changed
from app.core.engine.anchoring import anchor_floors, anchor_levels, anchor_votes
from app.core.engine.fixing import believe, may_scan_wifi, without
from app.core.engine.state import SessionState, Stride
from app.core.engine.walking import unseen_drift_m2
from app.core.fingerprint.cells import CellParams, cell_map
from app.core.fingerprint.query import Query, first_of, fresh_wifi_dbm, mean_ble_dbm, within
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.voting import VotingParams, heard_columns, hold_ballot
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.range_ekf import (
    RangeEkfParams,
    Ranges,
    carried,
    corrected,
    pulled,
    range_sigma_m,
)
from app.core.fusion.sighting import Sighting
from app.core.params import LevelOffsetParams, Params, ReportParams, SmootherParams
from app.core.radio.line_of_sight import Believed, LineOfSightParams, Sights, lines_of_sight
from app.core.radio.path_loss import DZ2, SLOPE, LevelModel, X, Y, distances_of_levels
from app.core.radio.windows import of_anchors
from app.core.site import SiteModel
from app.core.types import BleScan, FloatArray, Method, NoFixReason, Used, WifiScan


def _handheld_ekf() -> RangeEkfParams:
    """Return steps less exact than the paper's trained walker: nobody trains a visitor's phone.

    The heading's error holds the angle between phone and walk, of which this filter knows nothing.
    """
    return RangeEkfParams(along_share=0.2, heading_rad=0.4)


def _published_report() -> ReportParams:
    """Return what is added to P, fitted on the tuning walks of ms2020.

    95 % of the truth within ``radius95_m``, in every decile of the radius over 85 %.

    P takes the errors of steps for independent, and hardly grows with them; but a phone held askew
    errs alike with each. On a straight minute of 60 m they amount to (0.2² + 0.4²) / 2 (60 m)² on
    an axis, with the errors of `_handheld_ekf`: 6 m²/s. (Phones that look where they go need less:
    with the scans of 17 of those walks cut off, P alone holds 95 % of the truth.)
    """
    return ReportParams(covariance_scale=1.0, extra_variance_m2=40.0, unfixed_m2ps=6.0)


@dataclass(frozen=True, slots=True)
class Blunavi2020Params(Params):
    """Parameters of blunavi2020.

    Attributes
    ----------
    cells, voting, ekf, sight
        Of the blocks, as published where the paper prints them.
    place_sigma_m
        Error per axis of a place that all transmitters voted for; over the share that did, it is
        what the filter takes (on ms2020's tuning walks a constant error is 6 % worse).
    """

    profile: str = "blunavi2020"
    report: ReportParams = field(default_factory=_published_report)
    level_offset: LevelOffsetParams | None = None
    smoother: SmootherParams | None = None
    cells: CellParams = field(default_factory=CellParams)
    voting: VotingParams = field(default_factory=VotingParams)
    ekf: RangeEkfParams = field(default_factory=_handheld_ekf)
    sight: LineOfSightParams = field(default_factory=LineOfSightParams)
    place_sigma_m: float = 7.0


def walk_planar(
    state: SessionState, stride: Stride, site: SiteModel, params: Blunavi2020Params
) -> SessionState:
    """Carry the filter by a stride; before the first fix there is none."""
    _ = site
    if not isinstance(state.track, PlanarTrack):
        return state
    track = carried(state.track, stride.length_m, stride.heading_rad, params.ekf)
    return changed(state, track=track)


def widen_unseen(
    state: SessionState, scan: BleScan | WifiScan, site: SiteModel, params: Blunavi2020Params
) -> SessionState:
    """Widen the filter for motion that no sensor would have shown."""
    _ = site
    if not isinstance(state.track, PlanarTrack):
        return state
    drift_m2 = unseen_drift_m2(state, scan.time_s, params)
    covariance = state.track.covariance + drift_m2 * np.eye(2)
    track = PlanarTrack(state.track.mean, covariance)
    return changed(state, track=track, evidence=changed(state.evidence, drift_m2=drift_m2))


def correct_by_ranges(
    state: SessionState, scan: BleScan, site: SiteModel, params: Blunavi2020Params
) -> SessionState:
    """Correct the filter by the ranges of the beacons in line of sight, or begin it there."""
    if not site.anchors:
        mapless = site.radio_map is None
        return without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS) if mapless else state
    if not len(state.window):
        unknown = NoFixReason.UNKNOWN_TRANSMITTERS if scan.readings else NoFixReason.NOTHING_HEARD
        return without(state, unknown) if site.radio_map is None else state
    belief = believe(state, anchor_votes(state, site), scan.time_s, params)
    sights = _sights(state, int(np.argmax(belief)), site, params)
    if not sights.laterate:
        return without(state, NoFixReason.TOO_FEW_TRANSMITTERS)
    ranges = _ranges(sights, _levels(site, params), params)
    track = state.track if isinstance(state.track, PlanarTrack) else _at_nearest(ranges)
    return changed(
        state,
        track=corrected(track, ranges),
        floor_belief=belief,
        told_s=scan.time_s,
        method=Method.LATERATION if state.track is None else Method.FUSED,
        used=Used(beacons=len(ranges.range_m)),
    )


def vote_by_wifi(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Blunavi2020Params
) -> SessionState:
    """Let what is heard vote for a reference point, unless beacons in sight tell the place."""
    state = changed(state, wifi_s=scan.time_s)
    radio_map = site.radio_map
    if radio_map is None:
        return state if site.anchors else without(state, NoFixReason.NO_RADIO_MAP_OR_BEACONS)
    if _in_sight(state, site, params):
        return state
    choose = first_of(radio_map.column_by_key)
    wifi_dbm = fresh_wifi_dbm(scan, params.match.max_age_s, choose)
    if len(wifi_dbm) < params.match.min_readings and state.track is None:
        # An old neighbourhood is better than none; the filter soon leaves it.
        wifi_dbm = fresh_wifi_dbm(scan, params.match.first_max_age_s, choose)
    if len(wifi_dbm) < params.match.min_readings:
        few = NoFixReason.READINGS_TOO_OLD if scan.readings else NoFixReason.NOTHING_HEARD
        return without(state, few)
    recent = within(state.heard, scan.time_s, params.match.ble_window_s)
    query = Query(wifi_dbm, mean_ble_dbm(recent, choose))
    return _vote(state, query, scan.time_s, (site, radio_map), params)


def vote_by_beacons(
    state: SessionState, scan: BleScan, site: SiteModel, params: Blunavi2020Params
) -> SessionState:
    """Let beacons alone vote, for phones that cannot scan Wi-Fi or may not just now."""
    radio_map = site.radio_map
    if radio_map is None or may_scan_wifi(state, scan.time_s, params.match):
        return state
    if _in_sight(state, site, params):
        return state
    query = Query({}, mean_ble_dbm(state.heard, first_of(radio_map.column_by_key)))
    if len(query.ble_dbm) < params.match.min_readings:
        few = NoFixReason.TOO_FEW_TRANSMITTERS if query.ble_dbm else NoFixReason.NOTHING_HEARD
        return without(state, few)
    return _vote(state, query, scan.time_s, (site, radio_map), params)


def _vote(
    state: SessionState,
    query: Query,
    time_s: float,
    world: tuple[SiteModel, RadioMap],
    params: Blunavi2020Params,
) -> SessionState:
    site, radio_map = world
    cells = cell_map(radio_map, params.cells)
    column, rssi_dbm = heard_columns(query, radio_map)
    if not len(column):
        return without(state, NoFixReason.UNKNOWN_TRANSMITTERS)
    heard = len(query.wifi_dbm) + len(query.ble_dbm)
    ballot = hold_ballot(column, rssi_dbm, cells, params.voting)
    won = ballot.winner(params.voting.needed(heard))
    if won is None:
        return without(state, NoFixReason.OUTSIDE_MAPPED_AREA)
    votes = np.zeros(len(site.floors))
    votes[cells.floor_index[won]] = 1.0
    belief = believe(state, votes, time_s, params)
    state = changed(state, floor_belief=belief)
    if int(np.argmax(belief)) != cells.floor_index[won]:
        # A place of another floor says nothing of where on this one the phone is.
        return state
    place = np.array([cells.surveyed_x_m[won], cells.surveyed_y_m[won]])
    variance_m2 = (params.place_sigma_m * heard / int(ballot.votes[won])) ** 2
    noise_m2 = variance_m2, 0.0, variance_m2
    sighting = Sighting(time_s, place[None, :], np.ones(1), noise_m2, votes)
    return changed(
        state,
        track=_pulled(state, place, variance_m2),
        evidence=changed(state.evidence, sighting=sighting),
        told_s=time_s,
        method=Method.FINGERPRINT if state.track is None else Method.FUSED,
        used=Used(beacons=len(query.ble_dbm), access_points=len(query.wifi_dbm)),
    )


def _pulled(state: SessionState, place: FloatArray, variance_m2: float) -> PlanarTrack:
    noise_m2 = variance_m2 * np.eye(2)
    if not isinstance(state.track, PlanarTrack):
        return PlanarTrack(place, noise_m2)
    return pulled(state.track, place, noise_m2)


def _in_sight(state: SessionState, site: SiteModel, params: Blunavi2020Params) -> bool:
    """Return whether the ranges of beacons tell the place now."""
    if not site.anchors or not len(state.window) or state.floor_belief is None:
        return False
    return _sights(state, int(np.argmax(state.floor_belief)), site, params).laterate


def _sights(
    state: SessionState, floor_index: int, site: SiteModel, params: Blunavi2020Params
) -> Sights:
    window = of_anchors(state.window, anchor_floors(site) == floor_index)
    track = state.track
    believed = Believed(track.mean, track.covariance) if isinstance(track, PlanarTrack) else None
    return lines_of_sight(window, _levels(site, params), believed, params.sight)


def _levels(site: SiteModel, params: Blunavi2020Params) -> LevelModel:
    return anchor_levels(site, params.lateration.phone_height_m)


def _ranges(sights: Sights, model: LevelModel, params: Blunavi2020Params) -> Ranges:
    which = sights.anchor_index[sights.in_sight]
    table = model.table[which]
    range_m = distances_of_levels(LevelModel(table), sights.level_dbm[sights.in_sight])
    sigma_m = range_sigma_m(range_m, table[:, SLOPE], params.ekf)
    return Ranges(table[:, X : Y + 1], table[:, DZ2], range_m, sigma_m)


def _at_nearest(ranges: Ranges) -> PlanarTrack:
    """Return a track about the nearest beacon, as wide as its range."""
    nearest = int(np.argmin(ranges.range_m))
    spread_m = float(ranges.range_m[nearest] + ranges.sigma_m[nearest])
    return PlanarTrack(ranges.places[nearest], spread_m**2 * np.eye(2))
