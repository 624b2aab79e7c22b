"""Predicted error of a layout of anchors, without any measurement: what a planner wants to see.

Equation
--------
A phone at rest in ``p`` hears every anchor within reach in each of M epochs ``tau_k = t_k - t*``.
One epoch tells ``J = sum_i h_i h_i' / sigma_i^2``, ``h_i`` the gradient of anchor i's level at
``p``, and with ``S_1 = sum tau_k``, ``S_2 = sum tau_k^2`` the normal matrix of the window is::

    static     M J                     D = J^-1 / M
    kinematic  [[M J, S_1 J],          D = J^-1 S_2 / (M S_2 - S_1^2)
                [S_1 J, S_2 J]]            (its position block)

``sigma_xy = sqrt(D_11 + D_22)``. At the middle of the window ``S_1 = 0`` and the kinematic error
equals the static one; at the last epoch, where the *current* position is, it is nearly twice as
large.

Source: Grinyak, Grinyak, Tsybanov, The Territory of New Opportunities 10(2), 2018 (the matrix D);
the closed form follows because every anchor is heard in every epoch.
"""

from dataclasses import dataclass

import numpy as np

from app.core.radio.path_loss import SIGMA, LevelModel, X, Y, level_gradients
from app.core.types import FloatArray

SINGULAR = 1e-9
"""``det J`` below this share of ``(tr J)^2`` is rounding: the anchors heard lie on one line."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """When the levels of a window are measured.

    Attributes
    ----------
    epochs
        Number of times each anchor is heard.
    period_s
        Time between them.
    at_s
        The reference time t*, counted from the first epoch; None: the last epoch.
    """

    epochs: int = 28
    period_s: float = 0.07
    at_s: float | None = None

    def position_factor(self, *, kinematic: bool) -> float:
        """Return what multiplies ``J^-1`` to give the position's covariance."""
        if not kinematic:
            return 1.0 / self.epochs
        at_s = (self.epochs - 1) * self.period_s if self.at_s is None else self.at_s
        tau_s = np.arange(self.epochs) * self.period_s - at_s
        s1, s2 = float(tau_s.sum()), float((tau_s**2).sum())
        return s2 / (self.epochs * s2 - s1 * s1)


def predicted_covariance(
    model: LevelModel,
    x_m: FloatArray,
    y_m: FloatArray,
    schedule: Schedule,
    *,
    kinematic: bool,
    reach_m: float = np.inf,
) -> FloatArray:
    """Return the covariance of a fix at each place.

    Parameters
    ----------
    x_m, y_m : (...)
        Places, metres.
    reach_m
        Anchors farther than this, in the plane, are not heard.

    Returns
    -------
    (..., 2, 2)
        Covariance of the position, m^2; infinite where the anchors in reach leave a direction open.
    """
    x, y = np.ravel(x_m), np.ravel(y_m)
    h = level_gradients(model, x, y) / model.table[:, SIGMA, None]
    distance = np.hypot(x[:, None] - model.table[:, X], y[:, None] - model.table[:, Y])
    h = np.where((distance <= reach_m)[..., None], h, 0.0)
    J = np.einsum("pia,pib->pab", h, h)
    det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] ** 2
    regular = det > SINGULAR * (J[:, 0, 0] + J[:, 1, 1]) ** 2
    D = np.full_like(J, np.inf)
    adjugate = np.stack((J[:, 1, 1], -J[:, 0, 1], -J[:, 0, 1], J[:, 0, 0]), -1).reshape(-1, 2, 2)
    factor = schedule.position_factor(kinematic=kinematic)
    D[regular] = factor * adjugate[regular] / det[regular, None, None]
    return np.asarray(D.reshape(*np.shape(x_m), 2, 2))


def predicted_sigma_m(
    model: LevelModel,
    x_m: FloatArray,
    y_m: FloatArray,
    schedule: Schedule,
    *,
    kinematic: bool,
    reach_m: float = np.inf,
) -> FloatArray:
    """Return ``sigma_xy = sqrt(D_11 + D_22)`` at each place.

    The parameters are those of `predicted_covariance`.
    """
    D = predicted_covariance(model, x_m, y_m, schedule, kinematic=kinematic, reach_m=reach_m)
    return np.asarray(np.sqrt(D[..., 0, 0] + D[..., 1, 1]))


def cell_centres(width_m: float, height_m: float, cell_m: float) -> tuple[FloatArray, FloatArray]:
    """Return x and y of the centres of a plan's cells, each (rows, columns); rows grow with y."""
    x = (np.arange(round(width_m / cell_m)) + 0.5) * cell_m
    y = (np.arange(round(height_m / cell_m)) + 0.5) * cell_m
    columns, rows = np.meshgrid(x, y)
    return columns, rows
