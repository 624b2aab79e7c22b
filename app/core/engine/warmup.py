"""What would keep the first phone waiting, done before: kernels loaded, a site worked out."""

import math

import numpy as np

from app.core.engine.anchoring import anchor_floors, anchor_levels, wall_loss_db
from app.core.engine.match_noise import noise_ratio
from app.core.engine.order import order_key
from app.core.engine.profiles import PROFILES
from app.core.engine.smoothing import smoothed
from app.core.engine.standing import grounds
from app.core.fingerprint.match_index import match_index
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.params import Params
from app.core.site import Floor, SiteModel, Wall
from app.core.types import Anchor, BleScan, ImuBlock, Observation, Reading, Steps, WifiScan

_CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
_STEP_HZ, _RATE_HZ = 2.0, 50.0


def warm_up() -> None:
    """Fold and smooth two seconds of everything that runs a kernel, with every profile.

    A kernel is compiled at its first call, which takes seconds on a new machine, and read from the
    cache of an earlier run after that, which still takes longer than a phone's batch should.
    """
    walk, site = sorted(_short_walk(), key=order_key), _small_site()
    for profile in PROFILES.values():
        smoothed(walk, site, profile.params)


def prepare(site: SiteModel, params: Params) -> None:
    """Work out what the engine keeps of a site model, which else the first scan would wait for."""
    grounds(site)
    if site.radio_map is not None:
        match_index(site.radio_map, params.match)
        noise_ratio(site.radio_map, params.match, params.fusion)
    if site.anchors:
        anchor_floors(site)
        anchor_levels(site, params.lateration.phone_height_m)
    for anchor_index in range(len(site.anchors)):
        wall_loss_db(site, anchor_index)


def _small_site() -> SiteModel:
    """Return a hall with an anchor in each corner, a wall and three fingerprints."""
    floor = Floor("f", "Hall", "", 0, 0.0, 0.0, 10.0, 10.0, walls=(Wall(5.0, 0.0, 5.0, 4.0),))
    anchors = tuple(Anchor(f"a{i}", (f"b{i}",), "f", x, y) for i, (x, y) in enumerate(_CORNERS))
    wifi_dbm = {f"w{i}": -60.0 - i for i in range(5)}
    rows = [Fingerprint(0, x, 5.0, wifi_dbm, {"b0": -70.0}) for x in (2.0, 5.0, 8.0)]
    return SiteModel("warm-up", 1, (floor,), anchors, build_radio_map(("f",), rows))


def _short_walk() -> list[Observation]:
    beacons = tuple(Reading((f"b{i}",), -70.0 - i) for i in range(4))
    access_points = tuple(Reading((f"w{i}",), -60.0 - i) for i in range(5))
    count = int(2.0 * _RATE_HZ)
    swing = np.sin(2.0 * math.pi * _STEP_HZ / _RATE_HZ * np.arange(count))
    acc = np.column_stack([np.zeros((count, 2)), 9.81 + 3.0 * swing]).astype(np.float32)
    still, unknown = np.zeros((count, 3), np.float32), np.empty((0, 3), np.float32)
    walk = [
        observation
        for time_s in (0.0, 1.0, 2.0)
        for observation in (
            BleScan(time_s, beacons),
            WifiScan(time_s + 0.2, access_points),
            Steps(time_s + 0.4, 1),
        )
    ]
    return [ImuBlock(0.0, _RATE_HZ, acc, still, unknown, np.empty((0, 4), np.float32)), *walk]
