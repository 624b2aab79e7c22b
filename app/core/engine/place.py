"""What a session's track says: the place, how well it is known, and the velocity."""

import math

from app.core.engine.state import Stride, Track
from app.core.fusion.particles import BIAS, SCALE, Particles, moments
from app.core.types import FloatArray


def place_of(track: Track) -> tuple[FloatArray, FloatArray]:
    """Return the place (2,) and its covariance (2, 2)."""
    mean, covariance = moments_of(track)
    return mean[:2], covariance


def moments_of(track: Track) -> tuple[FloatArray, FloatArray]:
    """Return the mean of all that the filter estimates, the place in front, and its covariance."""
    if isinstance(track, Particles):
        return moments(track)
    return track.mean, track.covariance[:2, :2]


def velocity_mps(track: Track, mean: FloatArray, stride: Stride | None) -> tuple[float, float]:
    """Return the velocity that a filter of this mean carries, else the last stride's; 0: unknown.

    ``mean`` is that of `moments_of`, which takes longer than the rest.
    """
    if isinstance(track, Particles):
        return _of_stride(stride, float(mean[BIAS]), float(mean[SCALE]))
    if len(mean) == 4:
        return float(mean[2]), float(mean[3])
    return _of_stride(stride, 0.0, 1.0)


def _of_stride(stride: Stride | None, bias_rad: float, scale: float) -> tuple[float, float]:
    if stride is None or math.isnan(stride.heading_rad) or not stride.seconds > 0.0:
        return 0.0, 0.0
    speed = stride.length_m * scale / stride.seconds
    direction = stride.heading_rad + bias_rad
    return speed * math.cos(direction), speed * math.sin(direction)
