"""The cell map: the reference points of published systems, made of a radio map's survey scans.

A radio map has one row per survey scan; the published systems know reference points with N scans
each. So the floor is cut into square cells and the scans of a cell are one reference point. With
``u_i``, i = 1..n, the levels of transmitter t in the N scans of a cell (n <= N of them heard it)::

    mean = sum u_i / n,    share = n / N
    deviation^2 = (sum (u_i - mean)^2 + w s^2) / (n - 1 + w)

``s`` is the pooled deviation of all cells: a cell with two scans knows no deviation of its own, and
0 would say that its next scan must hear the very same level. Virtual fingerprints are left out,
nobody stood there.
"""

from dataclasses import dataclass, field

import numpy as np

from app.core.derived import derived
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class CellParams:
    """How a radio map is cut into cells.

    Attributes
    ----------
    cell_m
        Edge of a cell; blunavi2020 surveyed and scored cells of 3 m.
    pooled_weight
        ``w`` above, in scans.
    usual_deviation_db, usual_weight
        What the pooled deviation is believed to be before any cell has a second scan, and that
        belief's weight in scans; levels of a place vary by 4 to 6 dB with bodies and fading.
    """

    cell_m: float = 3.0
    pooled_weight: float = 3.0
    usual_deviation_db: float = 5.0
    usual_weight: float = 10.0


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class CellMap:
    """Cells (rows, by floor, then x, then y) by transmitters (the columns of the radio map).

    Attributes
    ----------
    cell_m
        Edge of a cell.
    floor_index, x_m, y_m : (cells,)
        Centre of each cell that has a scan.
    surveyed_x_m, surveyed_y_m : (cells,)
        Mean place of its scans: where the surveyor stood, seldom the centre.
    scans : (cells,)
        Survey scans of each cell, N.
    row_start : (cells + 1,)
        Compressed sparse rows: entries ``row_start[c]`` to ``row_start[c + 1]`` are of cell c.
    column : (entries,)
        Transmitter of each entry, ascending within a cell.
    mean_dbm, deviation_db, heard_share : (entries,)
        Mean and deviation of the levels heard, and share of the cell's scans that heard any.
    columns
        Number of transmitters.
    column_start : (columns + 1,), column_entry : (entries,), column_cell : (entries,)
        The inverted index: entries ``column_entry[column_start[t]:column_start[t + 1]]`` are of
        transmitter t, ``column_cell`` their cells, ascending.
    """

    cell_m: float
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    surveyed_x_m: FloatArray
    surveyed_y_m: FloatArray
    scans: IntArray
    row_start: IntArray
    column: IntArray
    mean_dbm: FloatArray
    deviation_db: FloatArray
    heard_share: FloatArray
    columns: int
    column_start: IntArray = field(init=False, repr=False)
    column_entry: IntArray = field(init=False, repr=False)
    column_cell: IntArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        cell = np.repeat(np.arange(self.cells), np.diff(self.row_start))
        order = np.argsort(self.column, kind="stable")
        counts = np.bincount(self.column, minlength=self.columns)
        object.__setattr__(self, "column_start", np.concatenate(([0], np.cumsum(counts))))
        object.__setattr__(self, "column_entry", order)
        object.__setattr__(self, "column_cell", cell[order])

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.x_m)


@derived()
def cell_map(radio_map: RadioMap, params: CellParams) -> CellMap:
    """Return the cells of a radio map; computed once per map.

    Columns are the radio map's own, so ``radio_map.column_by_key`` names them too. A map without
    survey scans has no cells.
    """
    surveyed = ~is_virtual(radio_map)
    places = np.column_stack([radio_map.x_m, radio_map.y_m])[surveyed]
    grid = np.column_stack([radio_map.floor_index[surveyed], cells_of(places, params.cell_m)])
    cells, cell_of_scan = np.unique(grid.astype(np.int64), axis=0, return_inverse=True)
    scans = np.bincount(cell_of_scan, minlength=len(cells))
    surveyed_m = [np.bincount(cell_of_scan, axis, len(cells)) / scans for axis in places.T]
    cell_of_row = np.full(radio_map.rows, -1)
    cell_of_row[surveyed] = cell_of_scan
    cell = np.repeat(cell_of_row, np.diff(radio_map.row_start))
    columns = len(radio_map.transmitters)
    levels = _levels(cell, radio_map, params)
    pair = levels.pair
    centre_m = (cells[:, 1:].astype(np.float64) + 0.5) * params.cell_m
    return CellMap(
        cell_m=params.cell_m,
        floor_index=cells[:, 0],
        x_m=centre_m[:, 0],
        y_m=centre_m[:, 1],
        surveyed_x_m=surveyed_m[0],
        surveyed_y_m=surveyed_m[1],
        scans=scans,
        row_start=np.searchsorted(pair, np.arange(len(cells) + 1) * columns),
        column=pair % max(columns, 1),
        mean_dbm=levels.mean_dbm,
        deviation_db=levels.deviation_db,
        heard_share=levels.count / scans[pair // max(columns, 1)],
        columns=columns,
    )


def cells_of(places: FloatArray, cell_m: float) -> IntArray:
    """Return the column and row (n, 2) of the grid cells that hold places (n, 2).

    Cell (i, j) reaches from ``i cell_m`` to ``(i + 1) cell_m`` in x and likewise in y: the grid
    hangs on the site's origin, so that equal floors have equal cells.
    """
    return np.floor(places / cell_m).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Levels:
    """What each pair (cell, transmitter) heard; ``pair`` is cell times columns plus column."""

    pair: IntArray
    count: IntArray
    mean_dbm: FloatArray
    deviation_db: FloatArray


def _levels(cell: IntArray, radio_map: RadioMap, params: CellParams) -> _Levels:
    here = cell >= 0
    rssi_dbm = radio_map.rssi_dbm[here]
    every = cell[here] * len(radio_map.transmitters) + radio_map.column[here]
    pair, entry, count = np.unique(every, return_inverse=True, return_counts=True)
    mean_dbm = np.bincount(entry, rssi_dbm, len(pair)) / count
    squares = np.bincount(entry, np.square(rssi_dbm - mean_dbm[entry]), len(pair))
    usual = params.usual_weight * params.usual_deviation_db**2
    pooled = (squares.sum() + usual) / (len(entry) - len(pair) + params.usual_weight)
    variance = (squares + params.pooled_weight * pooled) / (count - 1 + params.pooled_weight)
    return _Levels(pair, count, mean_dbm, np.sqrt(variance))
