"""Two radio maps compared: what came, what went, what is heard otherwise, and who errs where."""

import numpy as np
import pytest
from wifi_hall import levels_dbm

from app.core.fingerprint.comparison import ComparisonParams, compare_maps
from app.core.fingerprint.growth import GROWN
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.params import MatchParams

MATCH, PARAMS = MatchParams(), ComparisonParams()
KEY = "mac:000000000004"


def survey(
    seed: int, x_to_m: float = 40.0, noise_db: float = 2.0, walks: int = 4
) -> list[Fingerprint]:
    """Return a noisy scan every 2 m of the hall, the rows of places dealt out to walks."""
    rng = np.random.default_rng(seed)
    found = []
    for i, x in enumerate(np.arange(1.0, x_to_m, 2.0).tolist()):
        for y in np.arange(1.0, 40.0, 2.0).tolist():
            heard = {key: u + rng.normal(0.0, noise_db) for key, u in levels_dbm(x, y).items()}
            found.append(Fingerprint(0, x, y, heard, {}, f"walk {i % walks}"))
    return found


def map_of(fingerprints: list[Fingerprint]) -> RadioMap:
    return build_radio_map(("hall",), fingerprints)


def test_a_map_compared_with_itself_has_not_changed() -> None:
    radio_map = map_of(survey(1))
    change = compare_maps(radio_map, radio_map, MATCH, PARAMS)
    assert (change.gained, change.lost, change.levels) == ((), (), ())
    assert change.error_before_m == change.error_after_m
    assert all(place.rows_before == place.rows_after for place in change.places)
    assert len(change.places) == 64


def test_transmitters_and_places_that_came_and_went_are_listed() -> None:
    before, after = survey(1, x_to_m=30.0), survey(2)
    for scan in before:
        scan.wifi_dbm["mac:0000000000aa"] = -60.0
    for scan in after:
        scan.wifi_dbm["mac:0000000000bb"] = -60.0
    change = compare_maps(map_of(before), map_of(after), MATCH, PARAMS)
    assert "mac:0000000000bb" in change.gained
    assert change.lost == ("mac:0000000000aa",)
    gained = [place for place in change.places if not place.rows_before]
    assert {place.x_m for place in gained} == {32.5, 37.5}
    assert not [place for place in change.places if not place.rows_after]
    assert all(place.error_before_m is None for place in gained)


def test_a_transmitter_that_grew_louder_is_named_and_others_are_not() -> None:
    before, after = survey(1), survey(2)
    for scan in after:
        if KEY in scan.wifi_dbm:
            scan.wifi_dbm[KEY] += 12.0
    (changed,) = compare_maps(map_of(before), map_of(after), MATCH, PARAMS).levels
    assert changed.key == KEY
    assert changed.change_db == pytest.approx(12.0, abs=0.5)
    assert changed.cells > 30


def test_the_noisier_map_has_the_larger_error_everywhere_it_matters() -> None:
    change = compare_maps(map_of(survey(1)), map_of(survey(2, noise_db=9.0)), MATCH, PARAMS)
    assert change.error_before_m is not None
    assert change.error_after_m is not None
    assert change.error_after_m > 1.3 * change.error_before_m


def test_virtual_rows_are_neither_places_nor_answers() -> None:
    virtual = [
        Fingerprint(0, f.x_m, f.y_m, f.wifi_dbm, {}, VIRTUAL_WALK) for f in survey(1, walks=1)
    ]
    change = compare_maps(map_of(survey(1)), map_of([*survey(1), *virtual]), MATCH, PARAMS)
    assert all(place.rows_before == place.rows_after for place in change.places)
    assert change.error_before_m == change.error_after_m


def test_grown_rows_are_places_that_have_no_error_of_their_own() -> None:
    before = survey(1, x_to_m=30.0)
    grown = [
        Fingerprint(0, f.x_m, f.y_m, f.wifi_dbm, {}, f"{GROWN}s") for f in survey(2) if f.x_m > 30.0
    ]
    change = compare_maps(map_of(before), map_of([*before, *grown]), MATCH, PARAMS)
    gained = [place for place in change.places if not place.rows_before]
    assert sum(place.rows_after for place in gained) == len(grown)
    assert {place.error_after_m for place in gained} == {None}


def test_a_map_of_one_walk_knows_nothing_of_its_error() -> None:
    alone = map_of(survey(1, walks=1))
    change = compare_maps(alone, map_of(survey(2)), MATCH, PARAMS)
    assert change.error_before_m is None
    assert {place.error_before_m for place in change.places} == {None}
