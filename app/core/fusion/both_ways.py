"""A finished walk, followed by particles from both its ends: what two filters know of each place.

Forward the filter of `app.core.fusion.particles` knows at each place what was heard before; back,
over the same walk in reverse, what was heard after. With their means m and covariances P there
(Fraser and Potter 1969)::

    C⁻¹ = (P_f + c I)⁻¹ + (P_b + c I)⁻¹,   place = C ((P_f + c I)⁻¹ m_f + (P_b + c I)⁻¹ m_b)

Where one of them still keeps several places alive its covariance is large, and the other decides.
Both count what is heard at the place itself; so each scan is believed less than in a causal filter.
Before the first sighting and after the last one of them alone knows of the strides: they are walked
from the place that both tell there, and not from its own, which may be another one.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.core.fusion.ground import Ground
from app.core.fusion.particles import Particles, begin, diffuse, moments, update, walk
from app.core.fusion.smoother import Leg, Path
from app.core.params import FusionParams
from app.core.types import FloatArray

LEAST_VARIANCE_M2 = 1.0
"""c: particles that agree to the centimetre are not that sure (ms2020: flat up to 8)."""

_NONE = np.empty(0)


def follow_both_ways(legs: list[Leg], floors: Sequence[Ground], params: FusionParams) -> Path:
    """Return the path of the legs as the two filters know it together.

    Parameters
    ----------
    legs
        With one sighting at least.
    floors
        The ground of each leg's floor.
    """
    mean, information = _followed(legs, floors, params)
    back = _followed(_turned(legs), floors[::-1], params)
    mean_back, information_back = (part[::-1] for part in back)
    covariance = np.asarray(np.linalg.inv(information + information_back), dtype=np.float64)
    told = _times(information, mean) + _times(information_back, mean_back)
    place = _times(covariance, told)
    sighted = [i for i, leg in enumerate(legs) if leg.sighting is not None]
    first, last = sighted[0], sighted[-1]
    place[:first] = place[first] + mean_back[:first] - mean_back[first]
    place[last + 1 :] = place[last] + mean[last + 1 :] - mean[last]
    return Path(place, covariance)


def _turned(legs: list[Leg]) -> list[Leg]:
    """Return the legs of the same walk, walked the other way round."""
    moved = [*legs[1:], Leg(math.inf, _NONE, _NONE, 0.0, None, None)]
    return [
        replace(
            leg,
            length_m=after.length_m[::-1],
            heading_rad=after.heading_rad[::-1] + math.pi,
            drift_m2=after.drift_m2,
        )
        for leg, after in zip(reversed(legs), reversed(moved), strict=True)
    ]


def _followed(
    legs: Sequence[Leg], floors: Sequence[Ground], params: FusionParams
) -> tuple[FloatArray, FloatArray]:
    """Return the filter's place (n, 2) and information (n, 2, 2) at the end of each leg.

    No information before the first sighting. Particles are let go at once: those of all legs of a
    working day would be two gigabytes.
    """
    track: Particles | None = None
    mean, information = np.zeros((len(legs), 2)), np.zeros((len(legs), 2, 2))
    for i, (leg, floor) in enumerate(zip(legs, floors, strict=True)):
        if track is not None:
            track = _moved(track, leg, floor, params)
        if leg.sighting is not None:
            seen = leg.sighting
            track = (
                begin(seen, floor, params) if track is None else update(track, seen, floor, params)
            )
        if track is not None:
            state, covariance = moments(track)
            mean[i] = state[:2]
            information[i] = np.linalg.inv(covariance + LEAST_VARIANCE_M2 * np.eye(2))
    return mean, information


def _moved(track: Particles, leg: Leg, floor: Ground, params: FusionParams) -> Particles:
    for length_m, heading_rad in zip(leg.length_m.tolist(), leg.heading_rad.tolist(), strict=True):
        track = walk(track, (length_m, heading_rad), floor, params)
    return diffuse(track, leg.drift_m2, floor) if leg.drift_m2 > 0.0 else track


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))
