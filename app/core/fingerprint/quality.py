"""How good a radio map is, in metres: what a single scan would err, place by place.

A map can be asked about itself: each surveyed scan is matched as if its own walk were not there
(leave-one-walk-out), and lies e_i metres off. What a scan at another place q would err follows from
how densely q is surveyed, and from how the scans around it did:

    n(q) = Σ_i exp(-d_i² / (2 h²)),   g(q) = c_0 + c_1 / (1 + n(q))
    e(q) = g(q) (Σ_i w_i e_i / g_i + s r) / (Σ_i w_i + s),   w_i = exp(-d_i² / (2 h²))

over the scans i of q's floor, d_i their distance from q, r the mean of all e_i / g_i. c_0 and c_1
are fitted to the e_i by non-negative least squares, each scan's n made of the other walks alone, so
they are the building's own and the prediction is in metres. They are right within a quarter or
so: the full map knows one walk more than the one asked, and may have virtual fingerprints.
Fingerprints that grew from use are matched with, but neither asked nor counted in n: where they
truly are nobody knows.

On ms2020 density alone ranks errors best, their distance to the nearest scan a little worse, and
the spread of candidates not at all; so do errors around where they are not put against density.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import nnls

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.leaving_out import left_out_matches, single_fix, walk_numbers
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams
from app.core.types import FloatArray, IntArray

STRIDE_ROWS = 256
"""Against 20,000 scans 40 MB of weights at a time."""


@dataclass(frozen=True, slots=True)
class QualityParams:
    """How errors are predicted.

    Chosen on ms2020, each of folds 1 to 3 in turn asked of a map of the other two.

    Attributes
    ----------
    kernel_m
        h: about how far a fingerprint speaks for its surroundings (flat between 2 and 5).
    shrinkage
        s: scans' worth of what is usual; errors of single scans scatter far more than places do.
    error_cap_m
        Errors above count as this, as do scans that nothing resembles: one scan taken for another
        wing's would outweigh all others.
    """

    kernel_m: float = 3.0
    shrinkage: float = 20.0
    error_cap_m: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Surveyed scans (n,) and what they were matched with, their own walks left out.

    Attributes
    ----------
    floor_index, x_m, y_m, walk
        Where each was taken, and the number of its walk in ``walks``.
    fix_floor_index, fix_x_m, fix_y_m, spread_m
        The single fix, see `SingleFix`; floor -1 and nan where no other walk heard any of it.
    transmitters
        How many were heard.
    walks
        Names of the walks.
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
    walks: tuple[str, ...]

    @property
    def error_m(self) -> FloatArray:
        """Distance on the plane from fix to truth; nan without a fix."""
        return np.hypot(self.fix_x_m - self.x_m, self.fix_y_m - self.y_m)

    def places(self) -> FloatArray:
        """Return where the scans were taken (n, 2)."""
        return np.column_stack([self.x_m, self.y_m])

    def of_walks(self, names: frozenset[str]) -> "LeftOut":
        """Return the scans of these walks alone."""
        named = np.array([name in names for name in self.walks], dtype=np.bool_)
        keep = named[self.walk]
        arrays = {f.name: getattr(self, f.name)[keep] for f in fields(self) if f.name != "walks"}
        return LeftOut(**arrays, walks=self.walks)


def left_out_fixes(radio_map: RadioMap, params: MatchParams) -> LeftOut:
    """Return each surveyed scan with what the rest of the map says of it."""
    heard = radio_map.of_rows(~is_virtual(radio_map))
    surveyed = heard.of_rows(is_surveyed(heard))
    fixes = np.full((surveyed.rows, 4), np.nan)
    for row, (_, _, matches) in enumerate(left_out_matches(heard, params)):
        if matches is not None:
            fix = single_fix(matches)
            fixes[row] = fix.floor_index, fix.x_m, fix.y_m, fix.spread_m
    return LeftOut(
        floor_index=surveyed.floor_index,
        x_m=surveyed.x_m,
        y_m=surveyed.y_m,
        walk=walk_numbers(surveyed),
        fix_floor_index=np.where(np.isnan(fixes[:, 0]), -1, fixes[:, 0]).astype(np.int64),
        fix_x_m=fixes[:, 1],
        fix_y_m=fixes[:, 2],
        spread_m=fixes[:, 3],
        transmitters=np.diff(surveyed.row_start),
        walks=tuple(dict.fromkeys(surveyed.survey_walks)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ErrorModel:
    """What `predicted_error_m` needs to know of a map.

    Attributes
    ----------
    base_m, sparse_m
        c_0 and c_1: error where the survey is dense, and what is added where there is none.
    excess
        e_i / g_i of each scan.
    """

    left_out: LeftOut
    base_m: float
    sparse_m: float
    excess: FloatArray
    params: QualityParams


def fit_error_model(left_out: LeftOut, params: QualityParams) -> ErrorModel:
    """Return the model fitted to a map's leave-one-walk-out errors.

    Raises
    ------
    ValueError
        If there is no surveyed scan.
    """
    if not len(left_out.walk):
        msg = "no surveyed scan: there is nothing to learn errors from"
        raise ValueError(msg)
    error_m = np.minimum(
        np.nan_to_num(left_out.error_m, nan=params.error_cap_m), params.error_cap_m
    )
    sparse = np.empty(len(error_m))
    for rows in _strides(len(error_m)):
        weight = _weights(left_out.places()[rows], left_out.floor_index[rows], left_out, params)
        weight[left_out.walk[rows, None] == left_out.walk[None]] = 0.0
        sparse[rows] = 1.0 / (1.0 + weight.sum(axis=1))
    (base_m, sparse_m), _ = nnls(np.column_stack([np.ones_like(sparse), sparse]), error_m)
    usual_m = np.maximum(base_m + sparse_m * sparse, np.finfo(np.float64).tiny)
    return ErrorModel(left_out, float(base_m), float(sparse_m), error_m / usual_m, params)


def predicted_error_m(model: ErrorModel, places: FloatArray, floor_index: IntArray) -> FloatArray:
    """Return e(q) (n,) at places q (n, 2) of floors (n,)."""
    shrinkage = model.params.shrinkage
    lean = shrinkage * float(model.excess.mean())
    predicted_m = np.empty(len(places))
    for rows in _strides(len(places)):
        weight = _weights(places[rows], floor_index[rows], model.left_out, model.params)
        total = weight.sum(axis=1)
        usual_m = model.base_m + model.sparse_m / (1.0 + total)
        predicted_m[rows] = usual_m * (weight @ model.excess + lean) / (total + shrinkage)
    return predicted_m


def _strides(rows: int) -> Iterator[slice]:
    """Yield slices of some rows each: weights of all at once would take memory by their square."""
    for begin in range(0, rows, STRIDE_ROWS):
        yield slice(begin, begin + STRIDE_ROWS)


def _weights(
    places: FloatArray, floor_index: IntArray, left_out: LeftOut, params: QualityParams
) -> FloatArray:
    apart_m2 = np.square(places[:, None, 0] - left_out.x_m)
    apart_m2 += np.square(places[:, None, 1] - left_out.y_m)
    weight = np.exp(-0.5 * apart_m2 / params.kernel_m**2)
    return np.where(floor_index[:, None] == left_out.floor_index, weight, 0.0)
