"""Kernels of the windowed least squares: one damped, robust Gauss-Newton for static and kinematic.

Model
-----
State ``s = (x, y[, vx, vy][, o])`` at the reference time: position (m), velocity (m/s, kinematic
only), level offset of the phone (dB, only with a prior). A reading ``u_j`` of anchor ``i`` at
``tau_j = t_j - t*`` is expected to be ``h_j(s) = u_i(p + v tau_j) + o`` with the log-distance model
of `app.core.radio.path_loss`. With ``z_j = (u_j - h_j) / sigma_j`` the cost is

``C(s) = sum_j rho(z_j) + o^2 / sigma_o^2 + |v|^2 / sigma_v^2``,
``rho(z) = z^2`` for ``|z| <= k``, else ``2 k |z| - k^2`` (Huber),

and a step solves ``(A + lambda diag A) ds = g`` with ``A = H' W Q^-1 H`` (plus the priors'
diagonal), ``w = min(1, k / |z|)``: iteratively reweighted least squares with Marquardt damping,
which does not depend on the units of the state. ``lambda`` falls after a step that lowers the cost
and rises else.

Sources: Grinyak et al. 2018 (model); Huber 1964 (weights); Marquardt 1963 (damping).
"""

from typing import TypeAlias

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.radio.path_loss import DZ2, INTERCEPT, SLOPE, X, Y, squared_distance
from app.core.types import FloatArray, IntArray

Rows: TypeAlias = tuple[IntArray, FloatArray, FloatArray, FloatArray]
"""Levels to explain, four arrays of (rows,): anchor (row of the model's table), time since the
reference time (s), level (dBm), ``1 / sigma`` (1/dB)."""

Priors: TypeAlias = tuple[float, float, float]
"""Huber's k; inverse variances of a velocity component (s^2/m^2) and of the offset (1/dB^2)."""

STEP_TOLERANCE_M = 1e-3
"""The iteration ends with a position step below a millimetre: far under any noise."""

MAX_ITERATIONS = 40
"""About six are usual; flat valleys of poor layouts take more. Bounds the time of one fix."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e7
"""Range of lambda: nearly pure Gauss-Newton at first; at most, steps too small to matter."""


@register_jitable
def normal_equations(
    rows: Rows,
    table: FloatArray,
    state: FloatArray,
    priors: Priors,
    equations: tuple[FloatArray, FloatArray],
) -> float:
    """Fill the normal equations at a state and return the cost there.

    Parameters
    ----------
    rows
        See `Rows`.
    table : (anchors, 6)
        See `LevelModel.table`.
    state : (p,)
        Where to linearise; p is 2 (static) or 4 (kinematic), and one more with an offset.
    priors
        See `Priors`.
    equations : A (p, p) and g (p,)
        Output: ``H' W Q^-1 H`` and ``H' W Q^-1 z`` with the priors.
    """
    A, g = equations
    anchor, tau_s, rssi_dbm, precision = rows
    kinematic, with_offset = len(state) >= 4, len(state) % 2 == 1
    k, velocity_information, offset_information = priors
    p = len(state)
    row = np.zeros(p)
    _clear(A, g)
    cost = 0.0
    for j in range(len(anchor)):
        i = anchor[j]
        dx, dy = state[0] - table[i, X], state[1] - table[i, Y]
        if kinematic:
            dx += state[2] * tau_s[j]
            dy += state[3] * tau_s[j]
        d2 = squared_distance(dx, dy, table[i, DZ2])
        residual = rssi_dbm[j] - table[i, INTERCEPT] + 0.5 * table[i, SLOPE] * np.log(d2)
        gradient = -table[i, SLOPE] * precision[j] / d2
        row[0], row[1] = gradient * dx, gradient * dy
        if kinematic:
            row[2], row[3] = row[0] * tau_s[j], row[1] * tau_s[j]
        if with_offset:
            residual -= state[p - 1]
            row[p - 1] = precision[j]
        z = residual * precision[j]
        weight = 1.0 if abs(z) <= k else k / abs(z)
        cost += z * z if weight == 1.0 else 2.0 * k * abs(z) - k * k
        for a in range(p):
            g[a] += weight * row[a] * z
            for b in range(a + 1):
                A[a, b] += weight * row[a] * row[b]
    informations = (velocity_information, offset_information)
    return cost + _add_priors(state, with_offset, informations, A, g)


@register_jitable
def _add_priors(
    state: FloatArray,
    with_offset: bool,
    informations: tuple[float, float],
    A: FloatArray,
    g: FloatArray,
) -> float:
    """Add the priors (means 0), complete A's upper half; return the priors' cost."""
    p = len(state)
    cost = 0.0
    for a in range(2, p):
        information = informations[1 if with_offset and a == p - 1 else 0]
        A[a, a] += information
        g[a] -= information * state[a]
        cost += information * state[a] ** 2
    for a in range(p):
        for b in range(a):
            A[b, a] = A[a, b]
    return cost


@register_jitable
def _clear(A: FloatArray, g: FloatArray) -> None:
    for a in range(len(g)):
        g[a] = 0.0
        for b in range(len(g)):
            A[a, b] = 0.0


@njit(cache=True)
def minimise(
    rows: Rows,
    table: FloatArray,
    start: FloatArray,
    priors: Priors,
) -> tuple[FloatArray, float, FloatArray]:
    """Return the state of the nearest minimum, its cost and its information matrix ``A``.

    Parameters are those of `normal_equations`; ``start`` : (p,) is left as it is.
    """
    p = len(start)
    state, trial, step = start.copy(), np.empty(p), np.empty(p)
    A, g = np.empty((p, p)), np.empty(p)
    A_trial, g_trial, L = np.empty((p, p)), np.empty(p), np.empty((p, p))
    cost = normal_equations(rows, table, state, priors, (A, g))
    damping = FIRST_DAMPING
    for _ in range(MAX_ITERATIONS):
        damped_step(A, g, damping, L, step)
        for a in range(p):
            trial[a] = state[a] + step[a]
        trial_cost = normal_equations(rows, table, trial, priors, (A_trial, g_trial))
        if trial_cost <= cost:
            state, trial, cost = trial, state, trial_cost
            A, A_trial = A_trial, A
            g, g_trial = g_trial, g
            damping = max(0.1 * damping, LEAST_DAMPING)
            if abs(step[0]) < STEP_TOLERANCE_M and abs(step[1]) < STEP_TOLERANCE_M:
                break
        else:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
    return state, cost, A


@register_jitable
def damped_step(
    A: FloatArray, g: FloatArray, damping_scale: float, L: FloatArray, step: FloatArray
) -> None:
    """Fill the step ``(A + lambda diag A)^-1 g``; zeros where that is not positive definite.

    ``L`` (p, p) is left with the matrix's Cholesky factor.
    """
    p = len(g)
    for a in range(p):
        step[a] = g[a]
        for b in range(p):
            L[a, b] = A[a, b]
        L[a, a] += damping_scale * A[a, a]
    if cholesky(L):
        substitute(L, step)
    else:
        for a in range(p):
            step[a] = 0.0


def inverse(A: FloatArray) -> FloatArray | None:
    """Return the inverse of A (p, p); None if A is not safely positive definite."""
    L = A.copy()
    if not cholesky(L):
        return None
    D = np.eye(len(A))
    for column in D:
        substitute(L, column)
    return np.asarray(0.5 * (D + D.T))


@njit(cache=True)
def cholesky(A: FloatArray) -> bool:
    """Replace A's lower half by its Cholesky factor; False if A is as good as singular."""
    p = len(A)
    for a in range(p):
        pivot = A[a, a]
        bound = 1e-12 * pivot
        for c in range(a):
            pivot -= A[a, c] * A[a, c]
        if not pivot > bound:
            return False
        A[a, a] = np.sqrt(pivot)
        for b in range(a + 1, p):
            value = A[b, a]
            for c in range(a):
                value -= A[b, c] * A[a, c]
            A[b, a] = value / A[a, a]
    return True


@njit(cache=True)
def substitute(L: FloatArray, s: FloatArray) -> None:
    """Replace s (p,) by the solution of ``L L' x = s``."""
    p = len(s)
    for a in range(p):
        for c in range(a):
            s[a] -= L[a, c] * s[c]
        s[a] /= L[a, a]
    for a in range(p - 1, -1, -1):
        for c in range(a + 1, p):
            s[a] -= L[c, a] * s[c]
        s[a] /= L[a, a]
