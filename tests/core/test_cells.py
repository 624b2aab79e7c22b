"""The cell map: survey scans joined to the reference points that published systems know."""

import math

import numpy as np
import pytest

from app.core.fingerprint.cells import CellParams, cell_map, cells_of
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.virtual import VIRTUAL_WALK

PARAMS = CellParams(cell_m=3.0, pooled_weight=1.0, usual_deviation_db=4.0, usual_weight=2.0)


@pytest.fixture(scope="module")
def radio_map():
    return build_radio_map(
        ("ground", "upper"),
        [
            Fingerprint(1, 1.0, 1.0, {"w:b": -70.0}, {}, "upstairs"),
            Fingerprint(0, 4.0, -1.0, {"w:a": -50.0, "w:b": -80.0}, {}, "walk"),
            Fingerprint(0, 5.0, -2.0, {"w:a": -56.0}, {"b:c": -60.0}, "walk"),
            Fingerprint(0, 5.0, -2.0, {"w:a": -20.0}, {}, VIRTUAL_WALK),
            Fingerprint(0, 100.0, 100.0, {"w:a": -20.0}, {}, VIRTUAL_WALK),
        ],
    )


def entry(cells, radio_map, cell, key):
    column = radio_map.column_by_key[key]
    for i in range(cells.row_start[cell], cells.row_start[cell + 1]):
        if cells.column[i] == column:
            return i
    return None


def test_scans_of_one_square_of_one_floor_are_one_cell(radio_map):
    cells = cell_map(radio_map, PARAMS)
    assert cells.floor_index.tolist() == [0, 1]
    assert cells.x_m.tolist() == [4.5, 1.5]
    assert cells.y_m.tolist() == [-1.5, 1.5]
    assert cells.scans.tolist() == [2, 1]
    assert (cells.surveyed_x_m[0], cells.surveyed_y_m[0]) == (4.5, -1.5)
    assert (cells.surveyed_x_m[1], cells.surveyed_y_m[1]) == (1.0, 1.0)


def test_a_cell_holds_mean_share_and_deviation_of_what_its_scans_heard(radio_map):
    cells = cell_map(radio_map, PARAMS)
    a = entry(cells, radio_map, 0, "w:a")
    b = entry(cells, radio_map, 0, "w:b")
    assert cells.mean_dbm[a] == -53.0
    assert cells.heard_share[a] == 1.0
    assert cells.heard_share[b] == 0.5
    # Squares 18 of one spare scan, and 2 scans' worth of 4 dB: pooled variance 50 / 3.
    pooled = (18.0 + 2.0 * 16.0) / (1 + 2.0)
    assert cells.deviation_db[a] == pytest.approx(math.sqrt((18.0 + pooled) / 2.0))
    assert cells.deviation_db[b] == pytest.approx(math.sqrt(pooled))


def test_what_a_cell_did_not_hear_it_has_no_entry_for(radio_map):
    cells = cell_map(radio_map, PARAMS)
    assert entry(cells, radio_map, 1, "w:a") is None
    assert cells.row_start.tolist() == [0, 3, 4]


def test_the_inverted_index_holds_the_same_entries(radio_map):
    cells = cell_map(radio_map, PARAMS)
    by_row = {
        (c, int(cells.column[i]), float(cells.mean_dbm[i]))
        for c in range(cells.cells)
        for i in range(cells.row_start[c], cells.row_start[c + 1])
    }
    by_column = {
        (int(cells.column_cell[i]), t, float(cells.mean_dbm[cells.column_entry[i]]))
        for t in range(cells.columns)
        for i in range(cells.column_start[t], cells.column_start[t + 1])
    }
    assert by_row == by_column
    assert len(by_row) == 4


def test_a_map_is_cut_once(radio_map):
    assert cell_map(radio_map, PARAMS) is cell_map(radio_map, PARAMS)


def test_a_map_that_nobody_surveyed_has_no_cells():
    only_virtual = [Fingerprint(0, 1.0, 1.0, {"w:a": -60.0}, {}, VIRTUAL_WALK)]
    for rows in ([], only_virtual):
        cells = cell_map(build_radio_map(("ground",), rows), PARAMS)
        assert cells.cells == 0
        assert cells.row_start.tolist() == [0]


def test_a_place_on_an_edge_belongs_to_the_cell_above_it():
    places = np.array([[0.0, 0.0], [2.999, 3.0], [-0.001, -3.0]])
    assert cells_of(places, 3.0).tolist() == [[0, 0], [0, 1], [-1, -1]]
