"""Stages that remember what was heard."""

from app.core.changed import changed
from app.core.engine.state import SessionState
from app.core.fingerprint.query import hear
from app.core.params import Params
from app.core.radio.windows import joined, window_of_scan, within
from app.core.site import SiteModel
from app.core.types import BleScan


def hear_beacons(
    state: SessionState, scan: BleScan, site: SiteModel, params: Params
) -> SessionState:
    """Remember a scan's advertisements for the next fingerprint query."""
    _ = site
    return changed(state, heard=hear(state.heard, scan, params.match.ble_window_s))


def slide_window(
    state: SessionState, scan: BleScan, site: SiteModel, params: Params
) -> SessionState:
    """Add the levels of known anchors to the window and drop what has left it."""
    if not site.anchors:
        return state
    new = window_of_scan(scan.readings, scan.time_s, site.anchor_by_key)
    window = joined(state.window, new)
    return changed(
        state, window=within(window, scan.time_s - params.lateration.window_s, scan.time_s)
    )
