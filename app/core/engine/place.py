"""What a session's track says: the place, how well it is known, and the velocity."""

import math

from app.core.engine.state import SessionState, Stride, Track
from app.core.fusion.particles import Particles, moments
from app.core.types import FloatArray


def place_of(track: Track) -> tuple[FloatArray, FloatArray]:
    """Return the place (2,) and its covariance (2, 2)."""
    if isinstance(track, Particles):
        mean, covariance = moments(track)
        return mean[:2], covariance[:2, :2]
    return track.mean[:2], track.covariance[:2, :2]


def velocity_mps(state: SessionState) -> tuple[float, float]:
    """Return the velocity that the filter carries, else the last stride's; 0 if unknown."""
    track, stride = state.track, state.stride
    if track is None:
        return 0.0, 0.0
    if isinstance(track, Particles):
        bias_rad, scale = moments(track)[0][2:]
        return _of_stride(stride, float(bias_rad), float(scale))
    if len(track.mean) == 4:
        return float(track.mean[2]), float(track.mean[3])
    return _of_stride(stride, 0.0, 1.0)


def _of_stride(stride: Stride | None, bias_rad: float, scale: float) -> tuple[float, float]:
    if stride is None or math.isnan(stride.heading_rad) or not stride.seconds > 0.0:
        return 0.0, 0.0
    speed = stride.length_m * scale / stride.seconds
    direction = stride.heading_rad + bias_rad
    return speed * math.cos(direction), speed * math.sin(direction)
