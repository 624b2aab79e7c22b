"""Step length from the swings of forward and vertical acceleration, trained for a person.

Equation
--------
``l = K ((a_fh - a_fl) (a_vh - a_vl))^(1/4)``, with ``a_fh`` and ``a_fl`` the highest and lowest
forward, ``a_vh`` and ``a_vl`` the highest and lowest vertical acceleration within the step, and K a
constant of the person (leg length, gait), trained on a walk of known length::

    K = distance / sum over steps of ((a_fh - a_fl) (a_vh - a_vl))^(1/4)

which makes the trained walk right as a whole.

Source: Bao and Wong, "Improved PCA based step direction estimation for dead-reckoning localization
in body sensor networks", 2013, as used by Nguyen Ngoc Khuong, "BluNavi", 2021, whose printed form
is damaged.
"""

import numpy as np

from app.core.types import FloatArray


def swing_root(forward_swing_mps2: FloatArray, vertical_swing_mps2: FloatArray) -> FloatArray:
    """Return ``((a_fh - a_fl) (a_vh - a_vl))^(1/4)`` of steps (n,), (m/s²)^(1/2)."""
    return np.asarray((forward_swing_mps2 * vertical_swing_mps2) ** 0.25)


def trained_gain(root: FloatArray, distance_m: float) -> float:
    """Return K from the steps (n,) of a walk of known length (`swing_root`).

    Raises
    ------
    ValueError
        If there is no step with a swing.
    """
    total = float(root.sum())
    if total <= 0.0:
        msg = "no step with a swing: the walk tells no step length"
        raise ValueError(msg)
    return distance_m / total


def step_lengths_m(root: FloatArray, gain: float) -> FloatArray:
    """Return the lengths (n,) of steps, ``K`` times their `swing_root`."""
    return np.asarray(gain * root)
