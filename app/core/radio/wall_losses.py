"""What walls take from a level: the multi-wall term of the level model.

Equation
--------
``L(p) = min(sum_w a_w [the straight line from the anchor to p crosses wall w], L_max)``, to be
taken off the level of `app.core.radio.path_loss`.

A map of it is made once for each anchor, on a square grid around it, so that a kernel only looks
it up.

Sources: COST 231 final report, 1999, ch. 4 (multi-wall model; its loss grows less than linearly,
since a signal finds its way around: hence the bound).
"""

import numpy as np
from numba import njit
from numba.extending import register_jitable

from app.core.types import FloatArray

MAX_LOSS_DB = 20.0
"""Through doors and over the tops of racks a way around is found that costs about this."""

CELL_M = 0.5
"""A cell of the map: smaller than a room's narrowest part, larger than the plan is exact."""

REACH_CELLS = 40
"""The map reaches 20 m to every side, as far as beacons are heard; beyond, its edge counts."""

NO_LOSS: FloatArray = np.zeros((1, 1))
"""The map of an anchor among no walls."""


def wall_losses_db(
    walls: FloatArray, anchor_m: tuple[float, float], x_m: FloatArray, y_m: FloatArray
) -> FloatArray:
    """Return what walls take from an anchor's level at places.

    Parameters
    ----------
    walls : (walls, 5)
        Ends (x0, y0, x1, y1), m, and attenuation, dB.
    anchor_m
        Where the anchor is.
    x_m, y_m : (places,)
        Where the phone is.

    Returns
    -------
    (places,)
        dB, 0 to `MAX_LOSS_DB`.
    """
    return _losses(walls, anchor_m[0], anchor_m[1], np.asarray(x_m), np.asarray(y_m))


def loss_map_db(walls: FloatArray, anchor_m: tuple[float, float]) -> FloatArray:
    """Return the map of what walls take from an anchor's level, (cells, cells), rows along y.

    ``walls`` : (walls, 5) as in `wall_losses_db`.
    """
    reach_m = (REACH_CELLS + 0.5) * CELL_M
    x, y = anchor_m
    left, right = np.minimum(walls[:, 0], walls[:, 2]), np.maximum(walls[:, 0], walls[:, 2])
    low, high = np.minimum(walls[:, 1], walls[:, 3]), np.maximum(walls[:, 1], walls[:, 3])
    beside = (left > x + reach_m) | (right < x - reach_m)
    near = walls[~(beside | (low > y + reach_m) | (high < y - reach_m))]
    if not len(near):
        return NO_LOSS
    steps = np.arange(-REACH_CELLS, REACH_CELLS + 1) * CELL_M
    columns, rows = np.meshgrid(x + steps, y + steps)
    losses = wall_losses_db(near, anchor_m, columns.ravel(), rows.ravel())
    return losses.reshape(rows.shape)


@register_jitable
def loss_at(loss_db: FloatArray, dx_m: float, dy_m: float) -> float:
    """Return a map's loss at a place (m) seen from its anchor (kernels)."""
    cells = loss_db.shape[0]
    reach = cells // 2
    column = min(max(int(np.floor(dx_m / CELL_M + 0.5)) + reach, 0), cells - 1)
    row = min(max(int(np.floor(dy_m / CELL_M + 0.5)) + reach, 0), cells - 1)
    return float(loss_db[row, column])


@njit(cache=True)
def _losses(
    walls: FloatArray, u: float, v: float, x_m: FloatArray, y_m: FloatArray
) -> FloatArray:  # pragma: no cover - compiled
    losses = np.zeros(len(x_m))
    for p in range(len(x_m)):
        x, y = x_m[p], y_m[p]
        for w in range(len(walls)):
            x0, y0, x1, y1 = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
            wx, wy, dx, dy = x1 - x0, y1 - y0, u - x, v - y
            side_p, side_q = wx * (y - y0) - wy * (x - x0), wx * (v - y0) - wy * (u - x0)
            side_a, side_b = dx * (y0 - y) - dy * (x0 - x), dx * (y1 - y) - dy * (x1 - x)
            if side_p * side_q < 0.0 and side_a * side_b < 0.0:
                losses[p] += walls[w, 4]
        losses[p] = min(losses[p], MAX_LOSS_DB)
    return losses
