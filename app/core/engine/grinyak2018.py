"""The published system grinyak2018: windowed least squares on beacon levels, and nothing else.

Each scan's window of levels is solved by the static model for a phone at rest, by the kinematic one
for a phone that moves, and the solution is the answer: there is no filter and no dead reckoning.
Steps and acceleration only tell which model it is; without them the levels tell it themselves.

Source: Grinyak, Grinyak, Tsybanov, "Indoor positioning system based on Bluetooth beacons", The
Territory of New Opportunities 10(2), 2018.
"""

from dataclasses import dataclass, field

import numpy as np

from app.core.changed import changed
from app.core.engine.anchoring import anchor_votes
from app.core.engine.state import SessionState
from app.core.engine.windowing import solve_window
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.params import (
    LaterationParams,
    LevelOffsetParams,
    Params,
    ReportParams,
    SmootherParams,
)
from app.core.site import SiteModel
from app.core.types import BleScan, Method, NoFix, NoFixReason, WifiScan

PLAIN_K = 1e6
"""Huber's k beyond any residual: least squares without robust weights."""


def _published_lateration() -> LaterationParams:
    return LaterationParams(huber_k=PLAIN_K)


def _published_report() -> ReportParams:
    """Return D as it is; a solution stands for its window, so it is soon no answer any more."""
    return ReportParams(max_age_s=5.0, covariance_scale=1.0, extra_variance_m2=0.0)


@dataclass(frozen=True, slots=True)
class Grinyak2018Params(Params):
    """Parameters of grinyak2018: those of the paper, with D reported as it is."""

    profile: str = "grinyak2018"
    lateration: LaterationParams = field(default_factory=_published_lateration)
    report: ReportParams = field(default_factory=_published_report)
    level_offset: LevelOffsetParams | None = None
    smoother: SmootherParams | None = None


def locate_window(
    state: SessionState, scan: BleScan, site: SiteModel, params: Grinyak2018Params
) -> SessionState:
    """Make the window's solution the track, with D as its covariance.

    Where there is none the last one stands until it is too old.
    """
    if not site.anchors:
        return changed(state, reason=NoFixReason.NO_BEACONS)
    found, _, state = solve_window(state, scan, site, params)
    if isinstance(found, NoFix):
        return changed(state, reason=found.reason)
    fix = found.fix
    track = PlanarTrack(np.array([fix.x_m, fix.y_m, *(fix.velocity_mps or ())]), found.covariance)
    (xx, xy), (_, yy) = track.covariance[:2, :2].tolist()
    sighting = Sighting(
        scan.time_s, track.mean[None, :2], np.ones(1), (xx, xy, yy), anchor_votes(state, site)
    )
    return changed(
        state,
        track=track,
        evidence=changed(state.evidence, sighting=sighting),
        told_s=scan.time_s,
        method=Method.LATERATION,
        used=fix.used,
    )


def pass_over_wifi(
    state: SessionState, scan: WifiScan, site: SiteModel, params: Grinyak2018Params
) -> SessionState:
    """Learn nothing from access points, whose places nobody knows, but why there is no fix."""
    _ = scan, params
    if not site.anchors:
        return changed(state, reason=NoFixReason.NO_BEACONS)
    if state.reason is NoFixReason.NOT_STARTED:
        return changed(state, reason=NoFixReason.NOTHING_HEARD)
    return state
