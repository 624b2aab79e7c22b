"""Cross-validation of a calibration leaves out whole walks where levels come from several."""

import math

import numpy as np
import pytest

from app.core.radio.cross_validation import folds_by_walk
from app.core.types import Anchor
from app.services.beacon_calibration import FloorCalibration, calibrate_floor
from app.services.labelled_epochs import LabelledEpoch

PLACES = [(x + 0.5, y + 0.5) for x in range(0, 18, 2) for y in range(0, 12, 2)]
ANCHORS = [
    Anchor(name, (), "f", x, y)
    for name, x, y in (("a", 0.0, 0.0), ("b", 18.0, 0.0), ("c", 9.0, 12.0), ("d", 0.0, 12.0))
]
OF_WALK_DB = {"a": 5.0, "b": -5.0, "c": 5.0, "d": -5.0}
"""What one walker's body does to each beacon's level, and the other's the other way round."""


def epochs(*walks: tuple[str, float]) -> list[LabelledEpoch]:
    return [
        LabelledEpoch("phone", x, y, levels(x, y, sign), walk)
        for walk, sign in walks
        for x, y in PLACES
    ]


def levels(x_m: float, y_m: float, sign: float) -> dict[str, float]:
    return {
        a.anchor_id: -60.0
        - 20.0 * math.log10(math.hypot(a.x_m - x_m, a.y_m - y_m))
        + sign * OF_WALK_DB[a.anchor_id]
        for a in ANCHORS
    }


def residual_db(found: FloorCalibration) -> float:
    return float(np.mean([beacon.after_residual_db or 0.0 for beacon in found.beacons]))


def test_what_only_one_walk_heard_is_not_expected_of_the_other() -> None:
    found = calibrate_floor(epochs(("there", 1.0), ("back", -1.0)), ANCHORS)
    assert found.left_out == "walks"
    assert residual_db(found) > 5.0
    # With places left out, either walk tells what the other heard there.
    mixed = calibrate_floor(epochs(("", 1.0), ("", -1.0)), ANCHORS)
    assert mixed.left_out == "places"
    assert residual_db(mixed) < 1.0


@pytest.mark.parametrize("walks", [("there",), ("there", "")])
def test_places_are_left_out_where_there_are_no_walks_to(walks: tuple[str, ...]) -> None:
    found = calibrate_floor(epochs(*((walk, 1.0) for walk in walks)), ANCHORS)
    assert found.left_out == "places"
    assert residual_db(found) < 1.0


def test_a_walk_is_in_one_fold_and_folds_are_alike() -> None:
    names = [f"walk {i % 12}" for i in range(120)]
    fold = folds_by_walk(names)
    assert len(set(zip(names, fold.tolist(), strict=True))) == 12
    assert np.bincount(fold).tolist() == [30, 30, 20, 20, 20]
