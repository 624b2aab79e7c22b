"""The log-distance level model: what level an anchor is expected to give at a distance.

Equation
--------
``u(d) = u* - 10 n log10(d / d*)`` with ``u*`` the level in dBm at the calibration distance ``d*``
and ``n`` the path-loss exponent, all three per anchor; ``d`` is the distance in space between the
phone and the anchor. For plane coordinates ``(dx, dy) = p - p_anchor`` and a height difference
``dz``::

    d^2 = dx^2 + dy^2 + dz^2
    du/dx = -(10 n / ln 10) dx / d^2,    du/dy = -(10 n / ln 10) dy / d^2

Source: Grinyak, Grinyak, Tsybanov, "Indoor positioning system based on Bluetooth beacons", The
Territory of New Opportunities 10(2), 2018. The derivative printed there carries an extra factor
``d*``, which is a slip: it cancels in the logarithm (and vanishes only because ``d* = 1 m``).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba.extending import register_jitable

from app.core.types import Anchor, FloatArray

NEAR_FIELD_M = 0.3
"""Distances below this count as this.

The far field of a 2.4 GHz antenna (wavelength 0.125 m) begins at two to three wavelengths, and
neither phone nor beacon is surveyed better; without a bound the level at an anchor would be
infinite.
"""

# Columns of `LevelModel.table`.
X, Y, DZ2, INTERCEPT, SLOPE, SIGMA = range(6)


@dataclass(frozen=True, slots=True, eq=False)
class LevelModel:
    """The level models of several anchors, in the form that kernels take.

    Attributes
    ----------
    table : (anchors, 6)
        Per anchor: ``x`` and ``y`` (m), squared height difference ``dz^2`` (m^2), level at 1 m
        (dBm), slope ``10 n / ln 10`` (dB per neper of distance), shadowing (dB).
    """

    table: FloatArray

    @property
    def anchors(self) -> int:
        """Number of anchors."""
        return len(self.table)


def level_model(anchors: Sequence[Anchor], phone_height_m: float = 0.0) -> LevelModel:
    """Return the level models of anchors as heard at a height; row i is ``anchors[i]``."""
    table = np.empty((len(anchors), 6))
    for row, anchor in zip(table, anchors, strict=True):
        slope = 10.0 * anchor.path_loss_exponent / math.log(10.0)
        row[X], row[Y] = anchor.x_m, anchor.y_m
        row[DZ2] = (anchor.z_m - phone_height_m) ** 2
        row[INTERCEPT] = anchor.ref_level_dbm + slope * math.log(anchor.ref_distance_m)
        row[SLOPE] = slope
        row[SIGMA] = anchor.shadowing_db
    return LevelModel(table)


def expected_levels(model: LevelModel, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return the level of every anchor at every place.

    Parameters
    ----------
    x_m, y_m : (places,)
        Where the phone is.

    Returns
    -------
    (places, anchors)
        Levels, dBm.
    """
    squared = _squared_distances(model, x_m, y_m)[0]
    table = model.table
    return np.asarray(table[:, INTERCEPT] - 0.5 * table[:, SLOPE] * np.log(squared))


def level_gradients(model: LevelModel, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return the derivative of every level with respect to the place.

    Inside `NEAR_FIELD_M` the denominator stays at the bound: the row keeps pointing at the anchor
    and stays finite.

    Parameters
    ----------
    x_m, y_m : (places,)
        Where the phone is.

    Returns
    -------
    (places, anchors, 2)
        ``(du/dx, du/dy)``, dB per metre.
    """
    squared, offsets = _squared_distances(model, x_m, y_m)
    return np.asarray(-(model.table[:, SLOPE] / squared)[..., None] * offsets)


def distances_of_levels(model: LevelModel, rssi_dbm: FloatArray) -> FloatArray:
    """Return the distance at which each anchor is expected to give a level (inverse of the model).

    Parameters
    ----------
    rssi_dbm : (..., anchors)
        Levels.

    Returns
    -------
    (..., anchors)
        Distances in space, metres, at least `NEAR_FIELD_M`.
    """
    table = model.table
    return np.asarray(
        np.maximum(np.exp((table[:, INTERCEPT] - rssi_dbm) / table[:, SLOPE]), NEAR_FIELD_M)
    )


@register_jitable
def squared_distance(dx_m: float, dy_m: float, dz2_m2: float) -> float:
    """Return the squared distance in space, bounded by the near field (kernels)."""
    return max(dx_m * dx_m + dy_m * dy_m + dz2_m2, NEAR_FIELD_M * NEAR_FIELD_M)


def _squared_distances(
    model: LevelModel, x_m: FloatArray, y_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return bounded squared distances (places, anchors) and offsets (places, anchors, 2)."""
    places = np.stack((np.asarray(x_m), np.asarray(y_m)), axis=-1)
    offsets = places[:, None, :] - model.table[None, :, X : Y + 1]
    squared = np.maximum((offsets**2).sum(axis=-1) + model.table[:, DZ2], NEAR_FIELD_M**2)
    return squared, offsets
