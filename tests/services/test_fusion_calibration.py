"""The fit of liu2016's weights on labelled walks."""

from pathlib import Path

import numpy as np
import pytest
from wifi_hall import PACE_MPS, SIDE_M, START_S, hall, place_on, walked

from app.core.engine.liu2016 import Liu2016Params
from app.core.fusion.blending_weights import Unidentified, WeightFit
from app.core.types import WifiScan
from app.formats.ms2020 import Trace
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.services.fusion_calibration import (
    FusionCalibration,
    calibrated_fusion,
    labelled_epochs,
    map_paths,
)

CORNERS = [(5.0, 5.0), (35.0, 5.0), (35.0, 35.0), (5.0, 35.0), (5.0, 10.0)]
SECONDS = 90.0


def trace(seed: int, heading_error_rad: float) -> Trace:
    rng = np.random.default_rng(seed)
    observations = walked(CORNERS, rng, SECONDS, heading_error_rad)
    times = np.arange(0.0, SECONDS, 5.0)
    marks = [(START_S + t, *place_on(CORNERS, PACE_MPS * t)[:2]) for t in times.tolist()]
    return Trace(f"walk{seed}", "F1", tuple(observations), np.array(marks), {})


@pytest.fixture(scope="module")
def askew() -> FusionCalibration:
    """Walks of a phone whose heading is half a right angle off."""
    return calibrated_fusion([trace(seed, 0.8) for seed in range(3)], hall())


def test_a_heading_that_is_off_loses_weight_to_the_fixes(askew: FusionCalibration) -> None:
    heading = askew.fit.heading
    assert isinstance(heading, WeightFit)
    assert heading.weights[1] > askew.before.heading_weights[1] + 3.0 * heading.sigmas[1]
    assert sum(heading.weights) == pytest.approx(1.0)
    assert askew.after.heading_weights == heading.weights


def test_the_fitted_weights_follow_the_walks_better(askew: FusionCalibration) -> None:
    assert askew.before == Liu2016Params().blending
    assert askew.after_error_m < 0.97 * askew.before_error_m
    assert askew.traces == 3


def test_a_short_walk_leaves_the_weights_as_they_were() -> None:
    whole = trace(1, 0.0)
    few = tuple(o for o in whole.observations if o.time_s < START_S + 6.0)
    found = calibrated_fusion([Trace("short", "F1", few, whole.waypoints, {})], hall())
    assert isinstance(found.fit.speed, Unidentified)
    assert found.after == found.before
    assert found.after_error_m == found.before_error_m


def test_only_epochs_with_known_ends_are_labelled() -> None:
    whole = trace(1, 0.0)
    half = Trace("half", "F1", whole.observations, whole.waypoints[:10], {})
    scans = [o for o in whole.observations if isinstance(o, WifiScan)]
    known = [s for s in scans if s.time_s <= half.waypoints[-1, 0]]
    epochs = list(labelled_epochs(half, hall(), Liu2016Params()))
    assert len(epochs) == len(known) - 1


def test_labelled_walks_are_left_out_of_the_map() -> None:
    traces = tuple(Path("F1") / f"{name}.txt.xz" for name in ("one", "two", "three"))
    floor = FloorFolder("F1", 0, 0.0, 0.0, SIDE_M, SIDE_M, b"", {}, traces)
    building = BuildingFolder("hall", (floor,), ())
    assert map_paths(building, [Path("elsewhere") / "two.txt"]) == [traces[0], traces[2]]
