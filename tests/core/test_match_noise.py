"""How far matches lie from the truth is learned from the map itself."""

import numpy as np
import pytest
from wifi_hall import SIDE_M, levels_dbm

from app.core.engine.match_noise import FEWEST, LEAST, MOST, match_variance_m2, noise_ratio
from app.core.fingerprint.leaving_out import left_out_matches
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.params import Params

PARAMS = Params()
KNOWN = PARAMS.match, PARAMS.fusion
WIFI, BEACONS = Query({"mac:0": -60.0}, {}), Query({}, {"b": -60.0})


def surveyed(apart_m, virtual=False, sigma_db=8.0):
    """Return the map of walks along the hall, so far apart, and of virtual rows far off."""
    rng = np.random.default_rng(1)
    rows: list[Fingerprint] = []
    for y in np.arange(0.0, SIDE_M + 1.0, apart_m):
        for x in np.arange(0.0, SIDE_M + 1.0, 2.0):
            heard = {key: dbm + rng.normal(0.0, sigma_db) for key, dbm in levels_dbm(x, y).items()}
            rows.append(Fingerprint(0, x, y, heard, {}, f"walk {y}"))
    far_off = [
        Fingerprint(0, row.x_m + 500.0, row.y_m, levels_dbm(row.x_m, row.y_m), {}, VIRTUAL_WALK)
        for row in rows
    ]
    return build_radio_map(("f",), rows + far_off * virtual)


def test_a_thin_map_is_less_sure_of_what_it_barely_knows():
    dense, thin = surveyed(2.0), surveyed(20.0)
    assert noise_ratio(thin, *KNOWN) > 1.5 * noise_ratio(dense, *KNOWN)
    barely, well = (
        [match_variance_m2(WIFI, sorensen, one, KNOWN) for one in (dense, thin)]
        for sorensen in (0.5, 0.05)
    )
    assert barely[1] > 1.4 * barely[0]
    assert well[1] == pytest.approx(well[0], rel=0.01)


def test_a_map_with_too_few_scans_to_tell_is_taken_for_usual():
    few = build_radio_map(("f",), [Fingerprint(0, 0.0, 0.0, {"mac:0": -60.0}, {}, "one")])
    assert noise_ratio(few, *KNOWN) == 1.0
    assert match_variance_m2(WIFI, 0.0, few, KNOWN) == PARAMS.fusion.noise_m2


def test_a_few_scans_that_err_are_too_few_to_tell():
    thin = surveyed(20.0)
    assert noise_ratio(thin.of_rows(np.arange(thin.rows) < FEWEST - 1), *KNOWN) == 1.0


def test_the_ratio_is_bounded():
    assert noise_ratio(surveyed(20.0), *KNOWN) == MOST


def test_virtual_fingerprints_do_not_tell_the_ratio():
    noisy, with_virtual = (surveyed(2.0, virtual, sigma_db=14.0) for virtual in (False, True))
    assert LEAST < noise_ratio(noisy, *KNOWN) < MOST
    assert noise_ratio(noisy, *KNOWN) != 1.0
    assert noise_ratio(with_virtual, *KNOWN) == noise_ratio(noisy, *KNOWN)


def test_of_a_large_map_some_scans_are_asked_all_over_it():
    large = surveyed(2.0)
    rows = [row for row, _, _ in left_out_matches(large, PARAMS.match, 50)]
    assert 25 < len(rows) <= 50
    assert max(np.diff([*rows, large.rows])) < 2 * large.rows / len(rows)


def test_beacons_alone_do_not_ask_the_map():
    variance = {match_variance_m2(BEACONS, 0.5, surveyed(a), KNOWN) for a in (2.0, 20.0)}
    assert len(variance) == 1
