"""What the evaluations of ageing and of the survey report say of a simulated floor."""

import math

import numpy as np
import pytest

from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import BLE, WIFI, Fingerprint, RadioMap, build_radio_map
from app.core.types import FloatArray
from app.services.evaluation.ageing import ageing_figures, permuted, renamed
from app.services.evaluation.single_scans import HeldOut, PlacedQuery
from app.services.evaluation.survey_report import report_figures, thirds

SIDE_M, TRANSMITTERS = 60.0, 80
ALL_OVER, WEST = (0.0, SIDE_M), (0.0, 0.4 * SIDE_M)


def heard_dbm(
    x_m: float, y_m: float, sites_m: FloatArray, rng: np.random.Generator
) -> dict[str, float]:
    heard = {}
    for i, (ax, ay) in enumerate(sites_m.tolist()):
        away_m = max(math.hypot(x_m - ax, y_m - ay), 1.0)
        level_dbm = -40.0 - 35.0 * math.log10(away_m) + rng.normal(0.0, 4.0)
        if level_dbm > -85.0:
            heard[f"mac:{i:012x}"] = level_dbm
    return heard


def walked(
    walks: int, within_m: tuple[float, float], rng: np.random.Generator
) -> list[tuple[int, float, float]]:
    """Return the places of straight walks from south to north."""
    places = []
    for walk in range(walks):
        x_m = rng.uniform(*within_m)
        places += [(walk, x_m, y_m) for y_m in np.arange(1.0, SIDE_M, 4.0).tolist()]
    return places


def held_out(surveyed_m: tuple[float, float]) -> HeldOut:
    rng = np.random.default_rng(7)
    sites_m = rng.uniform(0.0, SIDE_M, (TRANSMITTERS, 2))
    survey = [
        Fingerprint(0, x, y, heard_dbm(x, y, sites_m, rng), {}, f"survey-{walk}")
        for walk, x, y in walked(20, surveyed_m, rng)
    ]
    scans = [
        PlacedQuery(f"walk-{walk}", 0, x, y, Query(heard_dbm(x, y, sites_m, rng), {}))
        for walk, x, y in walked(20, ALL_OVER, rng)
    ]
    return HeldOut(build_radio_map(("F1",), survey), tuple(scans))


@pytest.fixture(scope="module")
def everywhere() -> HeldOut:
    return held_out(ALL_OVER)


def test_identities_change_places_among_transmitters_of_one_radio() -> None:
    levels_dbm = [{f"{kind}:{i}": -50.0 for i in range(20)} for kind in ("mac", "beacon")]
    radio_map = build_radio_map(("F1",), [Fingerprint(0, 0.0, 0.0, *levels_dbm)])
    names = permuted(radio_map, 0.25, np.random.default_rng(1))
    assert names == permuted(radio_map, 0.25, np.random.default_rng(1))
    assert set(names) == set(names.values())
    assert all(old != new for old, new in names.items())
    assert [sum(_radio(radio_map, key) == kind for key in names) for kind in (WIFI, BLE)] == [5, 5]
    assert all(_radio(radio_map, old) == _radio(radio_map, new) for old, new in names.items())


def _radio(radio_map: RadioMap, key: str) -> int:
    return int(radio_map.radio[radio_map.column_by_key[key]])


def test_levels_go_with_the_new_names() -> None:
    query = Query({"a": -40.0, "b": -50.0, "c": -60.0}, {"d": -70.0})
    told = renamed(query, {"a": "b", "b": "a"})
    assert told == Query({"b": -40.0, "a": -50.0, "c": -60.0}, {"d": -70.0})


def test_what_changed_places_is_named_and_its_quarantine_helps(
    everywhere: HeldOut,
) -> None:
    figures = ageing_figures(everywhere, [0])
    assert figures["scans"] == len(everywhere.scans)
    assert figures["unchanged_named"] == 0
    assert figures["precision_10"]["median"] == figures["precision_25"]["median"] == 1.0
    assert figures["recall_10"]["median"] >= 0.7
    assert figures["recall_25"]["median"] >= 0.7
    assert 1.0 < figures["quarantined_25"]["median"] < figures["permuted_25"]["median"]


def test_a_half_surveyed_floor_is_foretold_bad_where_nobody_walked(everywhere: HeldOut) -> None:
    half, whole = report_figures(held_out(WEST)), report_figures(everywhere)
    assert half["scans"] == len(everywhere.scans)
    assert half["spearman"] > 0.6 > abs(whole["spearman"])
    assert half["worst_third_m"] > half["middle_third_m"]
    assert half["worst_to_best_third"] == half["worst_third_m"] / half["best_third_m"]
    assert half["worst_to_best_third"] > 3.0
    assert half["mean_error_m"] > whole["mean_error_m"]


def test_thirds_are_those_of_the_prediction() -> None:
    predicted_m = np.array([3.0, 1.0, 2.0, 6.0, 5.0, 4.0])
    error_m = np.array([10.0, 1.0, 3.0, 7.0, 9.0, 20.0])
    assert thirds(predicted_m, error_m) == (2.0, 15.0, 8.0)
