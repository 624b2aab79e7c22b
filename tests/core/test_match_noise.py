"""How far matches lie from the truth is learned from the map itself."""

import numpy as np
import pytest
from wifi_hall import SIDE_M, levels_dbm

from app.core.engine.match_noise import LEAST, MOST, match_variance_m2, noise_ratio
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.params import Params

PARAMS = Params()
KNOWN = PARAMS.match, PARAMS.fusion
WIFI, BEACONS = Query({"mac:0": -60.0}, {}), Query({}, {"b": -60.0})


def surveyed(apart_m, virtual=0):
    """Return the map of walks along the hall, so far apart."""
    rng, rows = np.random.default_rng(1), []
    for y in np.arange(0.0, SIDE_M + 1.0, apart_m):
        for x in np.arange(0.0, SIDE_M + 1.0, 2.0):
            heard = {key: dbm + rng.normal(0.0, 8.0) for key, dbm in levels_dbm(x, y).items()}
            rows.append(Fingerprint(0, x, y, heard, {}, f"walk {y}"))
    strange = Fingerprint(0, 500.0, 500.0, levels_dbm(20.0, 4.0), {}, VIRTUAL_WALK)
    return build_radio_map(("f",), [*rows, *[strange] * virtual])


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


def test_the_ratio_is_bounded_and_virtual_fingerprints_do_not_tell_it():
    thin = noise_ratio(surveyed(20.0), *KNOWN)
    assert LEAST <= thin <= MOST
    assert noise_ratio(surveyed(20.0, virtual=40), *KNOWN) == thin


def test_beacons_alone_do_not_ask_the_map():
    variance = {match_variance_m2(BEACONS, 0.5, surveyed(a), KNOWN) for a in (2.0, 20.0)}
    assert len(variance) == 1
