"""The transmitters of a scan: heard against expected at the told place, used or why not."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from app.core.engine.explanation import Residual, Use
from app.core.engine.place import place_of
from app.core.engine.state import SessionState, Told
from app.core.fingerprint.expected import levels_near
from app.core.fingerprint.query import (
    KeyChoice,
    first_of,
    fresh_wifi_dbm,
    hear,
    mean_ble_dbm,
    within,
)
from app.core.params import Params
from app.core.radio.path_loss import expected_levels, level_model
from app.core.site import SiteModel
from app.core.types import BleScan, FloatArray, Method, WifiScan


@dataclass(frozen=True, slots=True)
class _Heard:
    """A transmitter with its level, before anything is expected of it."""

    key: str
    kind: str
    level_dbm: float
    use: Use
    anchor: int | None = None


def _way_of(told: Told, site: SiteModel) -> Method:
    """Return how a scan tells, or would tell, the place."""
    if told.means in {Method.LATERATION, Method.FINGERPRINT}:
        return told.means
    laterated = isinstance(told.scan, BleScan) and site.anchors and len(told.window)
    return Method.LATERATION if laterated else Method.FINGERPRINT


def residuals_of(
    state: SessionState, told: Told, site: SiteModel, params: Params
) -> tuple[Residual, ...]:
    """Return all that the scan heard, loudest first."""
    floor = None if state.floor_belief is None else int(np.argmax(state.floor_belief))
    place = None if told.after is None or floor is None else place_of(told.after)[0]
    if _way_of(told, site) is Method.LATERATION and isinstance(told.scan, BleScan):
        heard = [*_anchors_heard(told, floor, site), *_others_heard(told.scan, site)]
    else:
        heard = [*_wifi_heard(told, site, params), *_ble_heard(told, site, params)]
    expected: dict[str, float] = {}
    if place is not None and floor is not None and site.radio_map is not None:
        expected = levels_near(site.radio_map, floor, float(place[0]), float(place[1]))
    if place is not None:
        expected |= _of_anchors(heard, place, site, params)
    found = [_residual(one, expected, told, site) for one in heard]
    return tuple(sorted(found, key=lambda r: (-r.heard_dbm, r.key)))


def _residual(one: _Heard, expected: dict[str, float], told: Told, site: SiteModel) -> Residual:
    level_dbm = expected.get(one.key)
    unused = one.use is Use.USED and told.means is None
    return Residual(
        key=one.key,
        kind=one.kind,
        anchor_id=None if one.anchor is None else site.anchors[one.anchor].anchor_id,
        heard_dbm=one.level_dbm,
        expected_dbm=level_dbm,
        residual_db=None if level_dbm is None else one.level_dbm - level_dbm,
        use=Use.NO_FIX if unused else one.use,
    )


def _anchors_heard(told: Told, floor: int | None, site: SiteModel) -> Iterator[_Heard]:
    window = told.window
    for anchor in np.unique(window.anchor_index).tolist():
        mean_dbm = float(window.rssi_dbm[window.anchor_index == anchor].mean())
        on_floor = floor is None or site.floor_index(site.anchors[anchor].floor_id) == floor
        use = Use.USED if on_floor else Use.OTHER_FLOOR
        if site.anchors[anchor].anchor_id in told.evidence.left_out:
            use = Use.GATED
        yield _Heard(site.anchors[anchor].keys[0], "ble", mean_dbm, use, anchor)


def _others_heard(scan: BleScan, site: SiteModel) -> Iterator[_Heard]:
    levels = {
        reading.keys[-1]: reading.rssi_dbm
        for reading in scan.readings
        if not any(key in site.anchor_by_key for key in reading.keys)
    }
    return (_Heard(key, "ble", level, Use.UNKNOWN) for key, level in levels.items())


def _of_anchors(
    heard: list[_Heard], place: FloatArray, site: SiteModel, params: Params
) -> dict[str, float]:
    # The model knows no slabs: of an anchor on another floor it expects nothing.
    anchors = [
        (one.key, site.anchors[one.anchor])
        for one in heard
        if one.anchor is not None and one.use is not Use.OTHER_FLOOR
    ]
    if not anchors:
        return {}
    model = level_model([anchor for _, anchor in anchors], params.lateration.phone_height_m)
    levels = expected_levels(model, place[:1], place[1:2])[0]
    return {key: float(level) for (key, _), level in zip(anchors, levels, strict=True)}


def _wifi_heard(told: Told, site: SiteModel, params: Params) -> Iterator[_Heard]:
    if not isinstance(told.scan, WifiScan):
        return
    known, choose = _known(site)
    match = params.match
    fresh = fresh_wifi_dbm(told.scan, match.max_age_s, choose)
    if len(fresh) < match.min_readings and told.before is None:
        fresh = fresh_wifi_dbm(told.scan, match.first_max_age_s, choose)
    for key, level_dbm in fresh_wifi_dbm(told.scan, np.inf, choose).items():
        use = _use(key, fresh.get(key), known, match.wifi_floor_dbm)
        yield _Heard(key, "wifi", fresh.get(key, level_dbm), use)


def _ble_heard(told: Told, site: SiteModel, params: Params) -> Iterator[_Heard]:
    known, choose = _known(site)
    match, scan = params.match, told.scan
    recent = within(told.heard, scan.time_s, match.ble_window_s)
    if not recent and isinstance(scan, BleScan):
        recent = hear((), scan, match.ble_window_s)
    fresh = mean_ble_dbm(recent, choose)
    every = {}
    if isinstance(scan, BleScan):
        every = mean_ble_dbm(hear((), scan, np.inf), choose)
    for key, level_dbm in (every | fresh).items():
        use = _use(key, fresh.get(key), known, match.ble_floor_dbm)
        yield _Heard(key, "ble", level_dbm, use)


def _known(site: SiteModel) -> tuple[dict[str, int], KeyChoice]:
    known = {} if site.radio_map is None else site.radio_map.column_by_key
    return known, first_of(known)


def _use(key: str, fresh_dbm: float | None, known: dict[str, int], floor_dbm: float) -> Use:
    if fresh_dbm is None:
        return Use.TOO_OLD
    if key not in known:
        return Use.UNKNOWN
    return Use.TOO_WEAK if fresh_dbm <= floor_dbm else Use.USED
