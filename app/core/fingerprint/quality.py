"""How good a radio map is, in metres: what single scans would err, place by place.

A map can be asked about itself: each surveyed scan is matched as if its own walk were not there
(leave-one-walk-out), and lies so and so many metres off. What a scan at another place would err is
predicted from three things that are known at every place q:

    f1(q) = (Σ_i w_i e_i + s ē) / (Σ_i w_i + s)   errors e_i around, w_i = exp(-d_i² / (2 h²))
    f2(q) = distance to the nearest surveyed scan, at most ``reach_m``
    f3(q) like f1 of the spread of the candidates that each scan was matched with

by non-negative least squares of the errors themselves on (1, f1, f2, f3), each scan's features made
of the other walks alone. So the weights are the building's own, and the prediction is in metres.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from app.core.fingerprint.leaving_out import is_surveyed, left_out_matches, single_fix
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class QualityParams:
    """How errors are predicted.

    Attributes
    ----------
    kernel_m
        Width of the kernel over errors.
    shrinkage
        Scans' worth of the mean error mixed in.
    reach_m
        Farther from any survey scan it is as bad as it gets.
    error_cap_m
        Errors above count as this: one scan matched with another wing would outweigh all others.
    """

    kernel_m: float = 5.0
    shrinkage: float = 2.0
    reach_m: float = 20.0
    error_cap_m: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Surveyed scans (n,) and what they were matched with, their own walks left out.

    Attributes
    ----------
    floor_index, x_m, y_m, walk
        Where each was taken, and the number of its walk.
    fix_floor_index, fix_x_m, fix_y_m, spread_m
        The single fix, see `SingleFix`; floor -1 and nan where no other walk heard any of it.
    transmitters
        How many were heard.
    """

    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    walk: IntArray
    fix_floor_index: IntArray
    fix_x_m: FloatArray
    fix_y_m: FloatArray
    spread_m: FloatArray
    transmitters: IntArray

    @property
    def error_m(self) -> FloatArray:
        """Distance on the plane from fix to truth; nan without a fix."""
        return np.hypot(self.fix_x_m - self.x_m, self.fix_y_m - self.y_m)

    def places(self) -> FloatArray:
        """Return where the scans were taken (n, 2)."""
        return np.column_stack([self.x_m, self.y_m])


def left_out_fixes(radio_map: RadioMap, params: MatchParams) -> LeftOut:
    """Return each surveyed scan with what the rest of the map says of it."""
    surveyed = radio_map.of_rows(is_surveyed(radio_map))
    names = {walk: i for i, walk in enumerate(dict.fromkeys(surveyed.survey_walks))}
    fixes = np.full((surveyed.rows, 4), np.nan)
    for row, (_, matches) in enumerate(left_out_matches(surveyed, params)):
        if matches is not None:
            fix = single_fix(matches)
            fixes[row] = fix.floor_index, fix.x_m, fix.y_m, fix.spread_m
    return LeftOut(
        floor_index=surveyed.floor_index,
        x_m=surveyed.x_m,
        y_m=surveyed.y_m,
        walk=np.array([names[walk] for walk in surveyed.survey_walks], dtype=np.int64),
        fix_floor_index=np.where(np.isnan(fixes[:, 0]), -1, fixes[:, 0]).astype(np.int64),
        fix_x_m=fixes[:, 1],
        fix_y_m=fixes[:, 2],
        spread_m=fixes[:, 3],
        transmitters=np.diff(surveyed.row_start),
    )
