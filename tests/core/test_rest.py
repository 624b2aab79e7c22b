"""A phone at rest stays where it is, and leaves with the first steps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from app.core.engine import advance, finish, order_key, start
from app.core.params import Params
from app.core.simulate import warehouse
from app.core.simulate.radio import Transmitters
from app.core.site import SiteModel
from app.core.types import (
    BleScan,
    ImuBlock,
    Observation,
    Reading,
    Steps,
    TrackPoint,
    WifiScan,
)

WORLD = warehouse(seed=5)
PLACE = (30.0, 25.0)
REST_S, SETTLED_S, WALK_S = 75, 15, 4
NOISE_DB = 5.0
STEP_M, CADENCE_HZ = 0.7, 1.8


def heard(radio: Transmitters, x_m: float, rng: np.random.Generator) -> list[Reading]:
    mean_dbm = radio.mean_levels_dbm(np.array([[x_m, PLACE[1], 0.0]]))[0]
    level_dbm = mean_dbm + rng.normal(0.0, NOISE_DB, len(mean_dbm))
    return [
        Reading(anchor.keys, float(level))
        for anchor, level in zip(radio.anchors, level_dbm, strict=True)
        if level > radio.detection_dbm
    ]


def at_rest_then_east(rng: np.random.Generator) -> list[Observation]:
    """A quiet phone for `REST_S`, then steps along +x; scans all the while."""
    observations: list[Observation] = []
    for second in range(REST_S + WALK_S):
        x_m = PLACE[0] + max(second - REST_S, 0) * STEP_M * CADENCE_HZ
        readings = heard(WORLD.beacons, x_m, rng)
        observations.append(BleScan(second + 0.9, tuple(readings)))
        if second % 3 == 0:
            observations.append(WifiScan(second + 0.8, tuple(heard(WORLD.access_points, x_m, rng))))
        if second < REST_S:
            still = rng.normal((0.0, 0.0, 9.81), 0.05, (50, 3)).astype(np.float32)
            none, no_turn = np.empty((0, 3), np.float32), np.empty((0, 4), np.float32)
            observations.append(ImuBlock(float(second), 50.0, still, none, none, no_turn))
    steps = np.arange(REST_S, REST_S + WALK_S, 1.0 / CADENCE_HZ)
    observations += [Steps(float(t), 1, step_length_m=STEP_M, heading_rad=0.0) for t in steps]
    return sorted(observations, key=order_key)


def points(site: SiteModel, observations: Sequence[Observation]) -> dict[float, TrackPoint]:
    state, outputs = start(), []
    for observation in observations:
        state, more = advance(state, observation, site, Params())
        outputs += more
    outputs += finish(state, site, Params())
    return {o.time_s: o for o in outputs if isinstance(o, TrackPoint)}


@pytest.mark.parametrize(
    "site",
    [
        replace(WORLD.site, radio_map=None),
        replace(WORLD.site, anchors=()),
        WORLD.site,
    ],
    ids=["beacons", "radio map", "both"],
)
def test_a_phone_at_rest_stays_put_and_leaves_with_the_first_steps(site: SiteModel) -> None:
    spreads, gone = [], []
    for seed in range(4):
        track = points(site, at_rest_then_east(np.random.default_rng(seed)))
        rest = np.array(
            [(p.x_m, p.y_m) for t, p in track.items() if SETTLED_S <= t <= REST_S and t % 1 == 0]
        )
        assert len(rest) == REST_S - SETTLED_S + 1
        spreads.append(rest.std(axis=0))
        place = rest[-20:-1].mean(axis=0)
        after = track[REST_S + 2.0]
        gone.append(float(np.hypot(after.x_m - place[0], after.y_m - place[1])))
    assert np.sqrt(np.mean(np.square(spreads))) < 0.3
    assert min(gone) > 0.7
