"""An open hall full of beacons, surveyed on a grid, and a person who walks a rectangle through it.

Nothing stands in it: path loss, shadowing and fading alone make the levels.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.simulate.phone import Phone, ble_scans, steps
from app.core.simulate.radio import Transmitters, transmitters
from app.core.simulate.routes import TRUTH_RATE_HZ, WalkTruth
from app.core.simulate.world import survey_levels
from app.core.site import Floor, SiteModel
from app.core.types import Anchor, BleScan, FloatArray, Observation, Steps

FLOOR_ID = "hall"
DETECTION_DBM = -96.0
BEACON_HEIGHT_M = 2.5
_RANK = {Steps: 0, BleScan: 1}


@dataclass(frozen=True, slots=True, eq=False)
class Hall:
    """The hall as a server knows it (no beacon's place, only the survey), and what is there."""

    site: SiteModel
    beacons: Transmitters


@dataclass(frozen=True, slots=True)
class Layout:
    """A square hall.

    Attributes
    ----------
    side_m
        Its length and width.
    beacon_grid
        Beacons along x and y, evenly spread.
    survey_spacing_m
        Between reference points.
    """

    side_m: float
    beacon_grid: tuple[int, int]
    survey_spacing_m: float


def hall(layout: Layout, rng: np.random.Generator) -> Hall:
    """Return a hall with beacons of one model and its survey."""
    floor = Floor(FLOOR_ID, "Hall", "Hall", 0, 0.0, 0.0, layout.side_m, layout.side_m)
    beacons = transmitters(_beacons(layout, rng), (floor,), DETECTION_DBM, rng)
    count = round(layout.side_m / layout.survey_spacing_m)
    places = _grid((count, count), layout.side_m)
    points = np.column_stack([places, np.zeros(len(places))])
    fingerprints = [
        Fingerprint(0, float(x_m), float(y_m), {}, levels, f"point-{i:04d}")
        for i, ((x_m, y_m), levels) in enumerate(
            zip(places, survey_levels(beacons, points, rng), strict=True)
        )
    ]
    radio_map = build_radio_map((FLOOR_ID,), fingerprints)
    return Hall(SiteModel("hall", 1, (floor,), (), radio_map), beacons)


def straight_walk(corners_m: FloatArray, pace_mps: float) -> WalkTruth:
    """Return an even walk from corner to corner, (n, 2), starting at time 0."""
    legs_m = np.array([float(np.hypot(*(b - a))) for a, b in pairwise(corners_m)])
    passed_m = np.concatenate(([0.0], np.cumsum(legs_m)))
    time_s = np.arange(int(passed_m[-1] / pace_mps * TRUTH_RATE_HZ + 1e-9) + 1) / TRUTH_RATE_HZ
    walked_m = pace_mps * time_s
    return WalkTruth(
        time_s=time_s,
        x_m=np.interp(walked_m, passed_m, corners_m[:, 0]),
        y_m=np.interp(walked_m, passed_m, corners_m[:, 1]),
        storey=np.zeros(len(time_s)),
        walked_m=walked_m,
        floor_changes=(),
    )


def reported(
    world: Hall, phone: Phone, truth: WalkTruth, rng: np.random.Generator
) -> tuple[Observation, ...]:
    """Return what a phone tells of a walk, steps and one BLE scan a second, in event-time order."""
    told: list[Observation] = [
        *steps(phone, truth, rng),
        *ble_scans(phone, truth, world.beacons, rng),
    ]
    return tuple(sorted(told, key=lambda o: (o.time_s, _RANK[type(o)])))


def _beacons(layout: Layout, rng: np.random.Generator) -> tuple[Anchor, ...]:
    blank = Anchor("", (), FLOOR_ID, 0.0, 0.0, z_m=BEACON_HEIGHT_M, shadowing_db=4.0)
    return tuple(
        replace(
            blank,
            anchor_id=f"beacon-{i:02d}",
            keys=(f"mac:02be00{i:06x}",),
            x_m=float(x_m),
            y_m=float(y_m),
            ref_level_dbm=float(rng.normal(-59.0, 2.0)),
        )
        for i, (x_m, y_m) in enumerate(_grid(layout.beacon_grid, layout.side_m))
    )


def _grid(shape: tuple[int, int], side_m: float) -> FloatArray:
    """Return the middles of a square's equal cells, (columns * rows, 2)."""
    columns, rows = shape
    x_m = (np.arange(columns) + 0.5) * side_m / columns
    y_m = (np.arange(rows) + 0.5) * side_m / rows
    return np.array([(x, y) for y in y_m for x in x_m])
