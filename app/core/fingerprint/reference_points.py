"""Reference points: the survey scans of a place, with one cleaned level per transmitter.

A walked survey has one scan at a place; the published systems stood at each reference point for a
while. So the floor is cut into the cells of `app.core.fingerprint.cells`, the scans of a cell are
those of one reference point, and its levels are cleaned (`app.core.fingerprint.cleaning`). It
stands where they were made on average. Virtual fingerprints are left out, nobody stood there.
"""

from dataclasses import dataclass, field

import numpy as np

from app.core.derived import derived
from app.core.fingerprint.cells import cells_of
from app.core.fingerprint.cleaning import CleanedLevels, CleaningParams, clean_levels
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ReferencePointParams:
    """How survey scans become reference points.

    Attributes
    ----------
    cell_m
        Edge of the cell whose scans are one reference point: some four steps of a surveyor.
    cleaning
        How the levels of its scans become one.
    """

    cell_m: float = 3.0
    cleaning: CleaningParams = field(default_factory=CleaningParams)


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePoints:
    """Reference points by floor, then x, then y.

    Attributes
    ----------
    floor_index, x_m, y_m : (points,)
        Mean place of the scans of each.
    scans : (points,)
        How many there are.
    levels
        What they hear; transmitters are columns of the radio map.
    """

    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    scans: IntArray
    levels: CleanedLevels


@derived()
def reference_points(radio_map: RadioMap, params: ReferencePointParams) -> ReferencePoints:
    """Return the reference points of a radio map; computed once per map."""
    surveyed = ~is_virtual(radio_map)
    places = np.column_stack([radio_map.x_m, radio_map.y_m])[surveyed]
    grid = np.column_stack([radio_map.floor_index[surveyed], cells_of(places, params.cell_m)])
    cells, point_of_scan = np.unique(grid.astype(np.int64), axis=0, return_inverse=True)
    scans = np.bincount(point_of_scan, minlength=len(cells))
    x_m, y_m = (np.bincount(point_of_scan, axis, len(cells)) / scans for axis in places.T)
    point_of_row = np.full(radio_map.rows, -1)
    point_of_row[surveyed] = point_of_scan
    point = np.repeat(point_of_row, np.diff(radio_map.row_start))
    heard = point >= 0
    levels = clean_levels(
        point[heard], radio_map.column[heard], radio_map.rssi_dbm[heard], scans, params.cleaning
    )
    return ReferencePoints(cells[:, 0], x_m, y_m, scans, levels)
