"""What one scan says of the place: candidates with weights, and how far they may be off."""

from dataclasses import dataclass
from typing import TypeAlias

from app.core.types import FloatArray, IntArray

Noise: TypeAlias = tuple[float, float, float]
"""Covariance ``(xx, xy, yy)`` of a candidate about the truth, m²."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """The absolute evidence of one scan.

    Attributes
    ----------
    places : (n, 2)
        Candidates, m; one for lateration.
    weight : (n,)
        Their weights, summing to 1.
    floor_votes : (floors,)
        How much speaks for each floor; any scale.
    floor_index : (n,)
        Floor of each candidate; None: all are on the floor that is believed in.
    """

    time_s: float
    places: FloatArray
    weight: FloatArray
    noise_m2: Noise
    floor_votes: FloatArray
    floor_index: IntArray | None = None
