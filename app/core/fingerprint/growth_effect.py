"""What grown rows would change: surveyed scans placed without their own walk, before and after.

Each surveyed row is a query against the map without the rows of its walk and without virtual rows,
which were made of that walk too; it is placed at the weighted mean of its candidates on the floor
of most weight. Grown rows help to place, but are not asked: nobody knows where they truly are.

The grown rows were themselves placed by the whole survey, the walk that is left out included, so
the gain that is told leans to the good side.
"""

from dataclasses import dataclass, replace

import numpy as np

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.leaving_out import query_of, walk_numbers
from app.core.fingerprint.matching import likeness, match
from app.core.fingerprint.radio_map import RadioMap
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class GrowthEffect:
    """Mean errors of surveyed scans, alone and placed without their own walk.

    Attributes
    ----------
    scans
        Surveyed scans that both maps place.
    before_m, after_m
        Their mean errors; None where ``scans`` is 0.
    """

    scans: int
    before_m: float | None
    after_m: float | None


def growth_effect(before: RadioMap, after: RadioMap, params: MatchParams) -> GrowthEffect:
    """Compare a map with the same one grown: surveyed rows are those that both begin with."""
    errors = [left_out_errors_m(radio_map, params) for radio_map in (before, after)]
    told = ~np.isnan(errors[0]) & ~np.isnan(errors[1])
    if not told.any():
        return GrowthEffect(0, None, None)
    means = [float(error_m[told].mean()) for error_m in errors]
    return GrowthEffect(int(told.sum()), means[0], means[1])


def left_out_errors_m(radio_map: RadioMap, params: MatchParams) -> FloatArray:
    """Return the error of each surveyed row, in their order; nan where no other walk knows it."""
    heard = radio_map.of_rows(~is_virtual(radio_map))
    walk = walk_numbers(heard)
    surveyed = np.flatnonzero(is_surveyed(heard))
    longest = int(np.bincount(walk[surveyed]).max()) if len(surveyed) else 0
    # As many candidates more as a walk's own rows can take away.
    wider = replace(params, k=params.k + longest)
    return np.array([_error_m(heard, row, walk, wider, params) for row in surveyed.tolist()])


def _error_m(
    radio_map: RadioMap, row: int, walk: IntArray, wider: MatchParams, params: MatchParams
) -> float:
    matches = match(query_of(radio_map, row), radio_map, wider)
    if matches is None:
        return np.nan
    others = np.flatnonzero(walk[matches.row] != walk[row])[: params.k]
    if not len(others):
        return np.nan
    weight = likeness(matches.distance[others], matches.sorensen[others], params)
    floor = np.argmax(np.bincount(matches.floor_index[others], weight))
    weight = weight * (matches.floor_index[others] == floor)
    weight /= weight.sum()
    apart_x_m = weight @ matches.x_m[others] - radio_map.x_m[row]
    apart_y_m = weight @ matches.y_m[others] - radio_map.y_m[row]
    return float(np.hypot(apart_x_m, apart_y_m))
