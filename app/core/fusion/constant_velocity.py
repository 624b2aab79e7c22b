"""Kalman filter of a walker who keeps his velocity, on (x, y, vx, vy).

Model
-----
Over t seconds, with white-noise acceleration of density q (m²/s³) on each axis::

    x' = x + t vx,   vx' = vx        (y likewise)
    Q = q [[t³/3, t²/2], [t²/2, t]]  on (x, vx), and on (y, vy)

``q`` is told as ``velocity_walk_mps``, the deviation of a velocity component after one second:
q = velocity_walk² / 1 s. Places and velocities are measured with isotropic normal noise; both are
linear, so this is the plain Kalman filter.

Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation",
2001, section 6.2 (continuous white-noise acceleration); as the last stage of liu2016.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fusion.planar import PlanarTrack
from app.core.types import FloatArray

_PLACE, _VELOCITY = 0, 2


@dataclass(frozen=True, slots=True)
class ConstantVelocityParams:
    """How a walker moves, and how far off what is measured of him may be.

    Fitted on ms2020 (fold 1 against a map of folds 2 and 3); the error is flat within 3 % over a
    factor of 2 in each of the first four.

    Attributes
    ----------
    velocity_walk_mps
        Deviation of each velocity component after one second; a walker who turns a corner changes
        it by his whole speed.
    place_sigma_m
        Of a fix, on each axis.
    blended_sigma_mps
        Of a velocity blended at a fix, which holds much of the fix's own error.
    stride_sigma_mps
        Of the velocity of one stride: a seventh of its length, and its heading off by 30 degrees.
    begin_sigma_mps
        Of a velocity before anything is known of it: a walker's speed.
    """

    velocity_walk_mps: float = 1.0
    place_sigma_m: float = 5.5
    blended_sigma_mps: float = 1.0
    stride_sigma_mps: float = 0.7
    begin_sigma_mps: float = 1.0


def begun_at(place: FloatArray, sigma_m: float, velocity_sigma_mps: float) -> PlanarTrack:
    """Return the filter at a place (2,), its velocity unknown but for its size."""
    mean = np.array([place[0], place[1], 0.0, 0.0])
    variances = np.array([sigma_m, sigma_m, velocity_sigma_mps, velocity_sigma_mps]) ** 2
    return PlanarTrack(mean, np.diag(variances))


def moved_on(track: PlanarTrack, seconds: float, velocity_walk_mps: float) -> PlanarTrack:
    """Return the filter ``seconds`` later."""
    mean, covariance = track.mean.copy(), track.covariance.copy()
    predict(mean, covariance, seconds, velocity_walk_mps**2)
    return PlanarTrack(mean, covariance)


def followed(
    track: PlanarTrack,
    seconds: float,
    velocity_mps: tuple[float, float],
    place: FloatArray,
    params: ConstantVelocityParams,
) -> PlanarTrack:
    """Return the filter ``seconds`` later, after a blended velocity and the fix at that time."""
    track = moved_on(track, seconds, params.velocity_walk_mps)
    track = with_velocity(track, velocity_mps, params.blended_sigma_mps)
    return with_place(track, place, params.place_sigma_m)


def with_place(track: PlanarTrack, place: FloatArray, sigma_m: float) -> PlanarTrack:
    """Return the filter after a measured place (2,), m."""
    mean, covariance = track.mean.copy(), track.covariance.copy()
    measure(mean, covariance, _PLACE, (place[0], place[1]), sigma_m**2)
    return PlanarTrack(mean, covariance)


def with_velocity(
    track: PlanarTrack, velocity_mps: tuple[float, float], sigma_mps: float
) -> PlanarTrack:
    """Return the filter after a measured velocity."""
    mean, covariance = track.mean.copy(), track.covariance.copy()
    measure(mean, covariance, _VELOCITY, velocity_mps, sigma_mps**2)
    return PlanarTrack(mean, covariance)


@njit(cache=True)
def predict(m: FloatArray, p: FloatArray, t: float, q: float) -> None:  # pragma: no cover
    """Move mean (4,) and covariance (4, 4) in place by ``t`` seconds: P' = F P Fᵀ + Q."""
    for axis in range(2):
        m[axis] += t * m[axis + 2]
    for axis in range(2):
        for j in range(4):
            p[axis, j] += t * p[axis + 2, j]
    for axis in range(2):
        for i in range(4):
            p[i, axis] += t * p[i, axis + 2]
    for axis in range(2):
        p[axis, axis] += q * t**3 / 3.0
        p[axis, axis + 2] += q * t**2 / 2.0
        p[axis + 2, axis] += q * t**2 / 2.0
        p[axis + 2, axis + 2] += q * t


@njit(cache=True)
def measure(
    m: FloatArray, p: FloatArray, first: int, z: tuple[float, float], r: float
) -> None:  # pragma: no cover
    """Correct mean and covariance in place by components ``first`` and the next, variance ``r``.

    K = P Hᵀ S⁻¹ with S = H P Hᵀ + r I; P' = P - K S Kᵀ, kept symmetric.
    """
    a = p[first, first] + r
    b = p[first, first + 1]
    d = p[first + 1, first + 1] + r
    determinant = a * d - b * b
    e0, e1 = z[0] - m[first], z[1] - m[first + 1]
    column0, column1 = p[:, first].copy(), p[:, first + 1].copy()
    gain0 = (d * column0 - b * column1) / determinant
    gain1 = (a * column1 - b * column0) / determinant
    for i in range(4):
        m[i] += gain0[i] * e0 + gain1[i] * e1
    for i in range(4):
        for j in range(i, 4):
            p[i, j] -= gain0[i] * column0[j] + gain1[i] * column1[j]
            p[j, i] = p[i, j]
