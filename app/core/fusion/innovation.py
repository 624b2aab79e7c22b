"""What a filter made of a sighting: how far it was from the prediction, and what it let count.

The same rule as the updates apply, for explanations: see `app.core.fusion.mixture.update`. With z
the candidates' mean as the filter weighs them, y = z - H m and S = P + R (both of the place),

    NIS = y' S^-1 y,    wider = max(1, (dof + NIS) / (dof + 2)),    R is taken as wider R

(a Student-t measurement of ``dof`` degrees of freedom, Roth, Özkan, Gustafsson 2013).
"""

from dataclasses import dataclass

import numpy as np

from app.core.fusion.mixture import Mixture
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
    student_weight
        1 / wider, 0 to 1: how much of the sighting's information was taken; None where the filter
        takes all of it.
    seen_weight : (n,)
        Weights of the candidates as the filter saw them, summing to 1.
    """

    distance_m: float
    nis: float
    student_weight: float | None
    seen_weight: FloatArray


def innovation_of_mixture(mixture: Mixture, sighting: Sighting, params: FusionParams) -> Innovation:
    """Return what the component that explains the sighting best made of it.

    Each component weighs candidate i by w_i exp(-½ d_i' (P + g I)^-1 d_i), g the gate; the weights
    of all components are joined by how well each explains the scan.
    """
    gate_m2 = params.candidate_gate_m2 * np.eye(2)
    by_component = np.empty((len(mixture.weight), len(sighting.weight)))
    likelihood = np.empty(len(mixture.weight))
    for k, (m, p) in enumerate(zip(mixture.mean, mixture.covariance, strict=True)):
        s = p[:2, :2] + gate_m2
        d = sighting.places - m[:2]
        d2 = np.einsum("ni,ij,nj->n", d, np.linalg.inv(s), d)
        # Less the nearest one's distance: far from all of them the ratios still hold.
        seen = sighting.weight * np.exp(-0.5 * (d2 - d2.min()))
        by_component[k] = seen / seen.sum()
        nearest = np.exp(-0.5 * d2.min()) / (2.0 * np.pi * np.sqrt(np.linalg.det(s)))
        likelihood[k] = seen.sum() * nearest
    posterior = mixture.weight * (likelihood + params.clutter) ** params.tempering
    best = int(np.argmax(posterior))
    distance_m, nis = _against(
        by_component[best] @ sighting.places,
        mixture.mean[best],
        mixture.covariance[best],
        sighting,
    )
    wider = max(1.0, (params.student_dof + nis) / (params.student_dof + 2.0))
    joined = posterior @ by_component / posterior.sum()
    return Innovation(distance_m, nis, 1.0 / wider, joined)


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
