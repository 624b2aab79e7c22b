"""What changed from one radio map to another: transmitters, places, and the error by place.

Rows of the two maps lie elsewhere, so both are looked at in the cells of one grid
(`app.core.fingerprint.cells`), virtual rows left out. The error of a cell is that of its surveyed
rows, each placed by the walks other than its own (`app.core.fingerprint.quality`).
"""

import math
from collections import Counter
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from app.core.fingerprint.cells import cells_of
from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.quality import left_out_fixes
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams

Cell: TypeAlias = tuple[str, int, int]
"""Floor id, and the cell's column and row on the grid."""


@dataclass(frozen=True, slots=True)
class ComparisonParams:
    """How maps are compared.

    Attributes
    ----------
    cell_m
        Edge of the cells: the error of single scans is told to some metres.
    least_change_db, least_cells
        A transmitter's level has changed if it differs by so much on average over so many cells;
        phones of two surveys differ by some decibels already.
    """

    cell_m: float = 5.0
    least_change_db: float = 6.0
    least_cells: int = 3


@dataclass(frozen=True, slots=True)
class LevelChange:
    """A transmitter that is heard otherwise: after less before, over the cells that both know."""

    key: str
    change_db: float
    cells: int


@dataclass(frozen=True, slots=True)
class PlaceChange:
    """A cell of either map, by its centre.

    Attributes
    ----------
    rows_before, rows_after
        Fingerprints in it, surveyed or grown.
    error_before_m, error_after_m
        Mean cross-validated error of the surveyed ones; None where none can be placed.
    """

    floor_id: str
    x_m: float
    y_m: float
    rows_before: int
    rows_after: int
    error_before_m: float | None
    error_after_m: float | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """From one map to another.

    Attributes
    ----------
    gained, lost
        Keys of transmitters that only one of them holds.
    levels
        Transmitters heard otherwise, by how much.
    places
        Every cell of either; gained where ``rows_before`` is 0, lost where ``rows_after`` is.
    error_before_m, error_after_m
        Mean cross-validated error over the rows of cells that both know, cells counting alike; None
        if there is none.
    """

    gained: tuple[str, ...]
    lost: tuple[str, ...]
    levels: tuple[LevelChange, ...]
    places: tuple[PlaceChange, ...]
    error_before_m: float | None
    error_after_m: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Gridded:
    """A map's rows on the grid, virtual ones aside: their cells, and rows and error of each."""

    radio_map: RadioMap
    cell: list[Cell]
    rows: Counter[Cell]
    error_m: dict[Cell, float]


def compare_maps(
    before: RadioMap, after: RadioMap, match: MatchParams, params: ComparisonParams
) -> Comparison:
    """Return what changed."""
    one, other = (_gridded(radio_map, match, params) for radio_map in (before, after))
    places = tuple(
        _place(cell, one, other, params) for cell in sorted(one.rows.keys() | other.rows.keys())
    )
    both = [
        (place.error_before_m, place.error_after_m)
        for place in places
        if place.error_before_m is not None and place.error_after_m is not None
    ]
    means = np.mean(both, axis=0).tolist() if both else (None, None)
    return Comparison(
        gained=tuple(sorted(after.column_by_key.keys() - before.column_by_key.keys())),
        lost=tuple(sorted(before.column_by_key.keys() - after.column_by_key.keys())),
        levels=_level_changes(one, other, params),
        places=places,
        error_before_m=means[0],
        error_after_m=means[1],
    )


def _gridded(radio_map: RadioMap, match: MatchParams, params: ComparisonParams) -> _Gridded:
    heard = radio_map.of_rows(~is_virtual(radio_map))
    on_grid = cells_of(np.column_stack([heard.x_m, heard.y_m]), params.cell_m)
    cell: list[Cell] = [
        (heard.floor_ids[floor], *xy)
        for floor, xy in zip(heard.floor_index.tolist(), on_grid.tolist(), strict=True)
    ]
    errors: dict[Cell, list[float]] = {}
    asked = [name for name, is_asked in zip(cell, is_surveyed(heard), strict=True) if is_asked]
    error_m = left_out_fixes(heard, match).error_m
    for name, error in zip(asked, error_m.tolist(), strict=True):
        # Nan where no other walk heard any of it.
        if not math.isnan(error):
            errors.setdefault(name, []).append(error)
    means = {name: float(np.mean(of_cell)) for name, of_cell in errors.items()}
    return _Gridded(heard, cell, Counter(cell), means)


def _place(cell: Cell, one: _Gridded, other: _Gridded, params: ComparisonParams) -> PlaceChange:
    floor_id, column, row = cell
    return PlaceChange(
        floor_id=floor_id,
        x_m=(column + 0.5) * params.cell_m,
        y_m=(row + 0.5) * params.cell_m,
        rows_before=one.rows[cell],
        rows_after=other.rows[cell],
        error_before_m=one.error_m.get(cell),
        error_after_m=other.error_m.get(cell),
    )


def _level_changes(
    one: _Gridded, other: _Gridded, params: ComparisonParams
) -> tuple[LevelChange, ...]:
    changes = []
    for key in sorted(one.radio_map.column_by_key.keys() & other.radio_map.column_by_key.keys()):
        before, after = _mean_levels(one, key), _mean_levels(other, key)
        shared = before.keys() & after.keys()
        if len(shared) < params.least_cells:
            continue
        change_db = float(np.mean([after[cell] - before[cell] for cell in sorted(shared)]))
        if abs(change_db) >= params.least_change_db:
            changes.append(LevelChange(key, change_db, len(shared)))
    return tuple(sorted(changes, key=lambda change: -abs(change.change_db)))


def _mean_levels(gridded: _Gridded, key: str) -> dict[Cell, float]:
    """Return the mean level of a transmitter in each cell that heard it."""
    radio_map = gridded.radio_map
    column = radio_map.column_by_key[key]
    entries = slice(radio_map.column_start[column], radio_map.column_start[column + 1])
    levels: dict[Cell, list[float]] = {}
    rows, level_dbm = radio_map.row[entries], radio_map.column_rssi_dbm[entries]
    for row, level in zip(rows.tolist(), level_dbm.tolist(), strict=True):
        levels.setdefault(gridded.cell[row], []).append(level)
    return {cell: float(np.mean(of_cell)) for cell, of_cell in levels.items()}
