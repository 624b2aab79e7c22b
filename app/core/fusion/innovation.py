"""What a filter made of a sighting: how far it was from the prediction, and what it let count.

For explanations. With z the candidates' mean as the filter weighs them, y = z - H m and S = P + R
(both of the place), NIS = y' S^-1 y. The particle filter (`app.core.fusion.particles.update`)
weighs candidate i by w_i Σ_k W_k N(c_i; x_k, R) over its particles, and holds the sighting for
true, rather than for clutter q, with probability Σ_k W_k L_k / (L_k + q), L_k the sum over i of
w_i N(c_i; x_k, R).
"""

from dataclasses import dataclass

import numpy as np

from app.core.fusion.particles import Particles, moments, weights
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.params import FusionParams
from app.core.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """A sighting against the prediction.

    Attributes
    ----------
    distance_m
        Between the prediction and the mean of the candidates as weighed.
    nis
        Normalised innovation squared: chi-square with two degrees of freedom where both are right.
    inlier_probability
        How far the sighting was believed, 0 to 1; None where the filter believes everything.
    seen_weight : (n,)
        Weights of the candidates as the filter saw them, summing to 1.
    """

    distance_m: float
    nis: float
    inlier_probability: float | None
    seen_weight: FloatArray


def innovation_of_particles(
    particles: Particles, sighting: Sighting, params: FusionParams
) -> Innovation:
    """Return what the particle filter makes of a sighting, from the particles before it."""
    xx, xy, yy = sighting.noise_m2
    noise = np.array([[xx, xy], [xy, yy]])
    apart = sighting.places - particles.state[:, None, :2]
    far = 0.5 * np.einsum("kni,ij,knj->kn", apart, np.linalg.inv(noise), apart)
    peak = 1.0 / (2.0 * np.pi * np.sqrt(np.linalg.det(noise)))
    prior = weights(particles)
    # Less the nearest one's distance: far from all of them the ratios still hold.
    seen = sighting.weight * (prior @ np.exp(far.min() - far))
    seen /= seen.sum()
    likelihood = peak * np.exp(-far) @ sighting.weight
    inlier = float(prior @ (likelihood / (likelihood + params.clutter)))
    mean, covariance = moments(particles)
    distance_m, nis = _against(seen @ sighting.places, mean, covariance, sighting)
    return Innovation(distance_m, nis, inlier, seen)


def innovation_of_planar(track: PlanarTrack, sighting: Sighting) -> Innovation:
    """Return how far a sighting was from a plain Kalman filter's prediction."""
    z = sighting.weight @ sighting.places
    distance_m, nis = _against(z, track.mean, track.covariance, sighting)
    return Innovation(distance_m, nis, None, sighting.weight)


def _against(
    z: FloatArray, mean: FloatArray, covariance: FloatArray, sighting: Sighting
) -> tuple[float, float]:
    xx, xy, yy = sighting.noise_m2
    y = z - mean[:2]
    s = covariance[:2, :2] + np.array([[xx, xy], [xy, yy]])
    return float(np.hypot(*y)), float(y @ np.linalg.solve(s, y))
