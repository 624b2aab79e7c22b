"""Calibration and places of beacons on real recordings."""

from pathlib import Path

import pytest

from app.formats import uji_ble as uji_ble_files
from app.services.evaluation import uji_ble

pytestmark = pytest.mark.shared_data


@pytest.fixture(scope="module")
def figures(shared_data: Path) -> dict:
    folder = shared_data / "uji_ble_2018"
    anchors, scans = uji_ble_files.read_zone(folder, "geo")
    found = uji_ble.evaluate(anchors, (), scans, "geo")
    return dict(found.profiles)


def test_half_of_the_points_calibrate_as_well_as_all(figures: dict) -> None:
    half, every = (figures[f"calibrated_on_{which}"] for which in ("half", "all"))
    assert half["samples"] == every["samples"] > 900
    assert half["mean_error_m"] <= 1.05 * every["mean_error_m"]


def test_no_beacon_is_worse_than_with_the_floors_mean(figures: dict) -> None:
    assert figures["calibrated_on_half"]["worst_beacon_ratio"] <= 1.0 + 1e-9


def test_places_are_found_and_their_covariance_is_honest(figures: dict) -> None:
    places = figures["estimated_places"]
    assert places["place_mean_error_m"] < 1.7
    assert places["place_coverage95"] > 0.88
    assert places["mean_error_m"] < 1.2 * figures["calibrated_on_all"]["mean_error_m"]
