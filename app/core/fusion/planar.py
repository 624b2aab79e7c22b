"""A track in the plane: the state of the published systems' filters."""

from dataclasses import dataclass

from app.core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlanarTrack:
    """One normal belief of where the phone is.

    Attributes
    ----------
    mean : (n,)
        x, y (m), and vx, vy (m/s) where the filter carries a velocity (n = 4).
    covariance : (n, n)
        Of the same.
    """

    mean: FloatArray
    covariance: FloatArray
