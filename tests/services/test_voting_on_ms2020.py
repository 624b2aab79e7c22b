"""Voting on real scans: no worse than the nearest neighbour, on walks that tuning may see."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from app.core.fingerprint.cells import CellParams, cell_map
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.fingerprint.survey import chosen_keys, walk_fingerprints
from app.core.fingerprint.voting import VotingParams, heard_columns, hold_ballot
from app.core.params import MatchParams
from app.formats.ms2020 import fold_of, trace_id_of
from app.formats.ms2020_site import read_building
from app.formats.ms2020_survey import SurveyWalk, read_survey_walk
from app.services.evaluation.ms2020 import TUNING

FLOOR = "F1"
NOT_HEARD_DBM = -100.0


@dataclass(frozen=True)
class Scans:
    """The map of one floor's walks, and single scans to ask it for."""

    radio_map: RadioMap
    asked: list[Fingerprint]

    def errors_m(self, places: np.ndarray) -> np.ndarray:
        truth = np.array([(scan.x_m, scan.y_m) for scan in self.asked])
        return np.hypot(*(places - truth).T)


def fingerprints(walks: list[SurveyWalk], mapped: list[SurveyWalk]) -> list[Fingerprint]:
    rule = (chosen_keys(scan for walk in mapped for scan in walk.scans), MatchParams())
    found = []
    for walk in walks:
        time_s, x_m, y_m = walk.waypoints.T

        def place_at(t, time_s=time_s, x_m=x_m, y_m=y_m):
            inside = time_s[0] <= t <= time_s[-1]
            return (np.interp(t, time_s, x_m), np.interp(t, time_s, y_m)) if inside else None

        found += walk_fingerprints(walk.scans, place_at, 0, walk.trace_id, rule)
    return found


@pytest.fixture(scope="module")
def scans(shared_data):
    building = read_building(shared_data / "ms2020" / "site1")
    (floor,) = (floor for floor in building.floors if floor.name == FLOOR)
    walks = {1: [], 2: [], 3: []}
    for path in sorted(floor.traces):
        fold = fold_of(trace_id_of(path))
        if fold in walks:
            walks[fold].append(read_survey_walk(path))
    mapped = [walk for fold in sorted(TUNING.mapped) for walk in walks[fold]]
    radio_map = build_radio_map([FLOOR], fingerprints(mapped, mapped))
    return Scans(radio_map, fingerprints(walks[TUNING.asked], mapped))


def voted(scans, params):
    cells = cell_map(scans.radio_map, CellParams())
    places = []
    for scan in scans.asked:
        heard = heard_columns(Query(scan.wifi_dbm, scan.ble_dbm), scans.radio_map)
        won = hold_ballot(*heard, cells, params).winner(1)
        places.append((cells.surveyed_x_m[won], cells.surveyed_y_m[won]))
    return scans.errors_m(np.array(places))


def nearest(scans):
    """Return the errors of the row that is nearest in dB, what is not heard as -100 dBm."""
    radio_map = scans.radio_map
    rows = np.repeat(np.arange(radio_map.rows), np.diff(radio_map.row_start))
    levels = np.zeros((radio_map.rows, len(radio_map.transmitters)))
    levels[rows, radio_map.column] = radio_map.rssi_dbm - NOT_HEARD_DBM
    squares = (levels**2).sum(axis=1)
    places = []
    for scan in scans.asked:
        column, rssi_dbm = heard_columns(Query(scan.wifi_dbm, scan.ble_dbm), radio_map)
        row = np.argmin(squares - 2.0 * levels[:, column] @ (rssi_dbm - NOT_HEARD_DBM))
        places.append((radio_map.x_m[row], radio_map.y_m[row]))
    return scans.errors_m(np.array(places))


def test_voting_is_no_worse_than_the_nearest_neighbour(scans):
    assert len(scans.asked) > 150
    assert voted(scans, VotingParams()).mean() <= nearest(scans).mean()


def test_x_is_neither_so_small_that_places_lose_votes_nor_so_large_that_all_get_them(scans):
    usual = voted(scans, VotingParams()).mean()
    assert voted(scans, replace(VotingParams(), within_db=2.0)).mean() > 1.05 * usual
    assert voted(scans, replace(VotingParams(), within_db=25.0)).mean() > 1.05 * usual
