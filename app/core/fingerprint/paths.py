"""The paths that a radio map's survey walked, as far as its fingerprints still tell."""

import numpy as np

from app.core.fingerprint.growth import is_surveyed
from app.core.fingerprint.radio_map import RadioMap
from app.core.types import FloatArray

LONGEST_M = 10.0
"""Two fingerprints of a walk farther apart than this were not taken one after the other: scans are
2 to 4 s apart, and people walk at 1.3 m/s."""


def paths(radio_map: RadioMap, floor_index: int) -> FloatArray:
    """Return the straight pieces (n, 4) between successive fingerprints of one walk on a floor.

    What grew from use is left out: a filter must not learn ways from its own tracks. Each piece is
    x and y of its begin and its end, m. Rows of a walk are in the order of its scans.
    """
    rows = np.flatnonzero((radio_map.floor_index == floor_index) & is_surveyed(radio_map))
    walks = np.array(radio_map.survey_walks)[rows]
    xy_m = np.column_stack([radio_map.x_m, radio_map.y_m])[rows]
    order = np.argsort(walks, kind="stable")
    pieces = np.hstack([xy_m[order][:-1], xy_m[order][1:]])
    length_m = np.hypot(pieces[:, 2] - pieces[:, 0], pieces[:, 3] - pieces[:, 1])
    one_walk = walks[order][:-1] == walks[order][1:]
    return np.asarray(pieces[one_walk & (length_m > 0.0) & (length_m <= LONGEST_M)])
