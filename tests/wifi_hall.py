"""A hall with twelve access points and a fingerprint every 2 m; a phone's scans and steps in it."""

import math
from itertools import pairwise

import numpy as np

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.site import Floor, SiteModel
from app.core.types import Reading, Steps, WifiScan

SIDE_M, START_S = 40.0, 1000.0
ACCESS_POINTS = [(x, y) for x in (2.0, 14.0, 26.0, 38.0) for y in (2.0, 20.0, 38.0)]
PACE_MPS, STEP_S = 1.2, 0.55


def levels_dbm(x_m: float, y_m: float, rng: np.random.Generator | None = None) -> dict[str, float]:
    """Return what is heard at a place; with noise of 4 dB if a generator is given."""
    heard = {}
    for i, (ax, ay) in enumerate(ACCESS_POINTS):
        level = -40.0 - 28.0 * math.log10(max(math.hypot(x_m - ax, y_m - ay), 1.0))
        level += 0.0 if rng is None else rng.normal(0.0, 4.0)
        if level > -85.0:
            heard[f"mac:{i:012x}"] = level
    return heard


def hall() -> SiteModel:
    grid = np.arange(0.0, SIDE_M + 1.0, 2.0)
    surveyed = [Fingerprint(0, x, y, levels_dbm(x, y), {}) for x in grid for y in grid]
    floor = Floor("hall-F1", "F1", "hall", 0, 0.0, 0.0, SIDE_M, SIDE_M)
    return SiteModel("hall", 1, (floor,), radio_map=build_radio_map(("hall-F1",), surveyed))


def scan(time_s: float, x_m: float, y_m: float, rng: np.random.Generator | None = None) -> WifiScan:
    heard = levels_dbm(x_m, y_m, rng)
    return WifiScan(time_s, tuple(Reading((key,), level) for key, level in heard.items()))


def place_on(corners: list[tuple[float, float]], walked_m: float) -> tuple[float, float, float]:
    """Return the place and the direction walked after so many metres along the corners."""
    for (x0, y0), (x1, y1) in pairwise(corners):
        leg_m = math.hypot(x1 - x0, y1 - y0)
        if walked_m <= leg_m:
            share = walked_m / leg_m
            return x0 + share * (x1 - x0), y0 + share * (y1 - y0), math.atan2(y1 - y0, x1 - x0)
        walked_m -= leg_m
    return *corners[-1], math.atan2(y1 - y0, x1 - x0)


def walked(
    corners: list[tuple[float, float]],
    rng: np.random.Generator,
    seconds: float,
    heading_error_rad: float = 0.0,
) -> list[WifiScan | Steps]:
    """Return a scan every 2 s and the phone's steps of a walk along the corners."""
    scans = [
        scan(START_S + t, *place_on(corners, PACE_MPS * t)[:2], rng)
        for t in np.arange(0.0, seconds, 2.0).tolist()
    ]
    steps = []
    for t in np.arange(STEP_S, seconds, STEP_S).tolist():
        heading_rad = place_on(corners, PACE_MPS * t)[2] + heading_error_rad
        steps.append(Steps(START_S + t, 1, PACE_MPS * STEP_S, heading_rad))
    return sorted([*scans, *steps], key=lambda o: (o.time_s, isinstance(o, Steps)))
