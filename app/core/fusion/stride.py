"""One stride of the filter: the motion model that filtering and smoothing share."""

import math

from numba import njit

from app.core.types import FloatArray


@njit(cache=True)
def take_stride(
    m: FloatArray,
    p: FloatArray,
    transition: FloatArray,
    stride: tuple[float, float],
    noise: tuple[float, float, float],
) -> None:  # pragma: no cover - compiled
    """Move mean (4,) and covariance (4, 4) in place; multiply ``transition`` by the Jacobian.

    x += l e^s cos(h + b), y += l e^s sin(h + b), with the state (x, y, b, s); a heading of nan only
    widens. ``stride`` is length (m) and heading (rad), ``noise`` the variances along and across the
    step (m²) and of the heading bias (rad²).
    """
    length_m, heading_rad = stride
    along, cross, bias_walk = noise
    if math.isnan(heading_rad):
        p[0, 0] += 0.5 * length_m**2
        p[1, 1] += 0.5 * length_m**2
        return
    length = length_m * math.exp(m[3])
    c, s = math.cos(heading_rad + m[2]), math.sin(heading_rad + m[2])
    m[0] += length * c
    m[1] += length * s
    # P' = F P Fᵀ with F = I but for its upper right: rows first, then columns.
    for j in range(4):
        p[0, j] += -length * s * p[2, j] + length * c * p[3, j]
        p[1, j] += length * c * p[2, j] + length * s * p[3, j]
        transition[0, j] += -length * s * transition[2, j] + length * c * transition[3, j]
        transition[1, j] += length * c * transition[2, j] + length * s * transition[3, j]
    for j in range(4):
        p[j, 0] += -length * s * p[j, 2] + length * c * p[j, 3]
        p[j, 1] += length * c * p[j, 2] + length * s * p[j, 3]
    p[0, 0] += along * c * c + cross * s * s
    p[1, 1] += along * s * s + cross * c * c
    p[0, 1] += (along - cross) * c * s
    p[1, 0] = p[0, 1]
    p[2, 2] += bias_walk
