"""How far candidates lie from the truth: by what the map knows of a scan, and what of itself.

The less the nearest fingerprint resembles what is heard (Sørensen distance D1), the farther the
phone is from it::

    R = r0 (1 + q r1 D1⁴)   with Wi-Fi,      R = r0 (1 + r2 D1²)   of beacons alone

A scan that a dense map knows badly was taken near a fingerprint all the same; one that a thin map
knows badly may be far from all. So q is the map's own: it is asked of its own surveyed scans, each
as if its walk were not there, and with errors e of those that it knows badly (D1 > `BADLY_KNOWN`)::

    q = median(e² / (2 ln 2 R_1)) / `USUAL`,   R_1 = r0 (1 + r1 D1⁴)

since e² / (2 R) of a normal error in the plane has the median ln 2. The median, since some scans
are taken for another wing's, however good the map is.
"""

import math

import numpy as np

from app.core.derived import derived
from app.core.fingerprint.leaving_out import left_out_matches
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.params import FusionParams, MatchParams

BADLY_KNOWN = 0.3
"""D1 from which on most of R is what grows with it."""

USUAL = 1.4
"""The mean of a scan's candidates also errs by how far they are apart, and R is what comes on top:
the filter does best with the median over this (ms2020's tuning walks; with 1.2, 1 % worse)."""

LEAST, MOST = 0.5, 4.0
"""Bounds of q: ms2020's tuning maps have 0.6 to 1.2, a quarter of them 2, an eighth 3."""

ASKED, FEWEST = 600, 30
"""Scans asked at most, which takes some tenths of a second, and badly known ones for a median."""


def match_variance_m2(
    query: Query,
    nearest_sorensen: float,
    radio_map: RadioMap,
    params: tuple[MatchParams, FusionParams],
) -> float:
    """Return R, the variance of a scan's candidates about the truth (m², per axis)."""
    match, fusion = params
    if not query.wifi_dbm:
        # A few beacons resemble some fingerprint anywhere: D1² tells as much as can be told.
        return fusion.noise_m2 * (1.0 + fusion.noise_beacons_sorensen * nearest_sorensen**2)
    return _wifi_variance_m2(nearest_sorensen, noise_ratio(radio_map, match, fusion), fusion)


def _wifi_variance_m2(nearest_sorensen: float, ratio: float, fusion: FusionParams) -> float:
    return fusion.noise_m2 * (1.0 + ratio * fusion.noise_sorensen * nearest_sorensen**4)


@derived()
def noise_ratio(radio_map: RadioMap, match: MatchParams, fusion: FusionParams) -> float:
    """Return q, 1 for a map with too few scans to tell; computed once per map."""
    heard = radio_map.of_rows(~is_virtual(radio_map))
    ratios = []
    for row, query, matches in left_out_matches(heard, match, ASKED):
        if matches is None or not query.wifi_dbm or matches.nearest_sorensen < BADLY_KNOWN:
            continue
        apart_x_m = float(matches.weight @ matches.x_m) - heard.x_m[row]
        apart_y_m = float(matches.weight @ matches.y_m) - heard.y_m[row]
        usual_m2 = _wifi_variance_m2(matches.nearest_sorensen, 1.0, fusion)
        ratios.append((apart_x_m**2 + apart_y_m**2) / (2.0 * math.log(2.0) * usual_m2))
    if len(ratios) < FEWEST:
        return 1.0
    return float(np.clip(np.median(ratios) / USUAL, LEAST, MOST))
