"""Calibration of anchors: level and path-loss exponent of each, from levels heard at known places.

Equation
--------
Reading j of anchor i by phone p at a known place, ``L_j = log10(d_j / d*)``::

    u_j = u*_i - 10 n_i L_j + o_p + e_j,    e ~ N(0, sigma^2)
    (u*_i, n_i) ~ N((u*, n), T)             anchors of one model on one floor are alike
    o_p ~ N(0, sigma_o^2)                   phones are alike, less so

The mean ``(u*, n)``, the spread ``T`` and the noise ``sigma`` are estimated along, by expectation
maximisation: with ``x_j = (1, -10 L_j)``, ``S_i = sum x x'`` and ``c_i = sum x (u - o)``,

``V_i = (S_i / sigma^2 + T^-1)^-1``, ``m_i = V_i (c_i / sigma^2 + T^-1 m)``,
``m = mean m_i``, ``T = mean ((m_i - m)(m_i - m)' + V_i)``,
``sigma^2 = mean ((u - o - x' m_i)^2 + x' V_i x)``.

So an anchor that was heard often keeps its own least-squares fit, one that was heard a few times
stays near the floor's mean, and one that was never heard gets the mean itself. Offsets have no zero
of their own: their mean over the readings is put into the levels.

Sources: Laird and Ware, "Random-effects models for longitudinal data", Biometrics 38, 1982 (the
expectation maximisation); Grinyak et al. 2018 (the level model).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.radio.path_loss import NEAR_FIELD_M
from app.core.types import Anchor, BoolArray, FloatArray, IntArray

ROUNDS = 60
"""Rounds of expectation maximisation; the spread settles last, in some thirty."""


@dataclass(frozen=True, slots=True)
class CalibrationParams:
    """What is believed before anything is heard.

    Attributes
    ----------
    phone_height_m
        Height of the phone above the level that anchors' ``z_m`` counts from.
    level_spread_db, exponent_spread_ratio
        Usual deviation of an anchor from the floor's mean: beacons of one model differ by 1 to 3
        dB (batteries, antennas, how they are mounted), exponents by walls.
    spread_weight
        Anchors' worth of that belief in the spread that is estimated.
    noise_weight
        Readings' worth of the floor's noise in an anchor's own.
    offset_spread_db
        Usual deviation of a phone's levels from all phones' mean.
    min_exponent, max_exponent
        Bounds: waveguides reach 1, several walls 6; an anchor beyond gets the bound and the level
        that then fits best.
    """

    phone_height_m: float = 0.0
    level_spread_db: float = 3.0
    exponent_spread_ratio: float = 0.4
    spread_weight: float = 2.0
    noise_weight: float = 20.0
    offset_spread_db: float = 5.0
    min_exponent: float = 1.0
    max_exponent: float = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class LabelledLevels:
    """Levels heard at known places, (readings,) each.

    ``anchor_index`` and ``phone_index`` count from 0; one phone is all zeros.
    """

    anchor_index: IntArray
    phone_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    rssi_dbm: FloatArray

    def of(self, chosen: BoolArray) -> "LabelledLevels":
        """Return the readings (readings,) chosen."""
        return LabelledLevels(
            self.anchor_index[chosen],
            self.phone_index[chosen],
            self.x_m[chosen],
            self.y_m[chosen],
            self.rssi_dbm[chosen],
        )


def joined_levels(parts: Sequence[LabelledLevels]) -> LabelledLevels:
    """Return the levels of all parts, in their order."""
    return LabelledLevels(
        np.concatenate([part.anchor_index for part in parts]),
        np.concatenate([part.phone_index for part in parts]),
        np.concatenate([part.x_m for part in parts]),
        np.concatenate([part.y_m for part in parts]),
        np.concatenate([part.rssi_dbm for part in parts]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What the readings say of anchors and phones.

    Attributes
    ----------
    ref_level_dbm, path_loss_exponent, shadowing_db, readings : (anchors,)
        The level model of each anchor, its residual deviation, and how often it was heard.
    offset_db : (phones,)
        What each phone hears more than the mean one.
    mean_ref_level_dbm, mean_exponent
        The floor's mean: what an anchor of which nothing is known gets.
    determined_share : (anchors, 2)
        How much of level and exponent the anchor's own readings tell, 0 (nothing: they are the
        floor's mean) to 1 (all): ``1 - V_kk / T_kk``.
    residual_db
        Deviation of all readings from the models.
    """

    ref_level_dbm: FloatArray
    path_loss_exponent: FloatArray
    shadowing_db: FloatArray
    readings: IntArray
    offset_db: FloatArray
    determined_share: FloatArray
    mean_ref_level_dbm: float
    mean_exponent: float
    residual_db: float


def calibrate(
    levels: LabelledLevels, anchors: Sequence[Anchor], params: CalibrationParams
) -> Calibration:
    """Fit the level model of every anchor; see the equation above.

    Parameters
    ----------
    levels
        At least three readings at two different distances in all, so that the floor has a mean.
    anchors
        Their places and calibration distances count, their calibration does not.

    Raises
    ------
    ValueError
        If the readings cannot tell level from slope.
    """
    index, phone = levels.anchor_index, levels.phone_index
    count = np.bincount(index, minlength=len(anchors))
    x = _regressors(levels, anchors, params.phone_height_m)
    if len(x) < 3 or np.ptp(x[:, 1]) < 1e-6:
        msg = "levels at two different distances are needed at least"
        raise ValueError(msg)
    mean, *_ = np.linalg.lstsq(x, levels.rssi_dbm, rcond=None)
    noise2 = float(np.mean((levels.rssi_dbm - x @ mean) ** 2)) + 1e-6
    usual = np.diag([params.level_spread_db**2, params.exponent_spread_ratio**2])
    spread, offset = usual, np.zeros(int(phone.max()) + 1)
    S = _sums(index, x[:, :, None] * x[:, None, :], len(anchors))
    heard = count > 0
    for _ in range(ROUNDS):
        own = levels.rssi_dbm - offset[phone]
        c = _sums(index, x * own[:, None], len(anchors))
        V = np.linalg.inv(S / noise2 + np.linalg.inv(spread))
        m = (V @ (c / noise2 + np.linalg.solve(spread, mean))[:, :, None])[:, :, 0]
        mean = m[heard].mean(axis=0)
        apart = m[heard] - mean
        found = apart.T @ apart + V[heard].sum(axis=0)
        spread = (found + params.spread_weight * usual) / (heard.sum() + params.spread_weight)
        residual = own - (x * m[index]).sum(axis=1)
        noise2 = float(np.mean(residual**2) + np.einsum("iab,iba->", S, V) / len(own)) + 1e-6
        offset = _offsets(residual + offset[phone], phone, noise2 / params.offset_spread_db**2)
    m = _bounded(m, (index, x, levels.rssi_dbm - offset[phone]), params)
    residual = levels.rssi_dbm - offset[phone] - (x * m[index]).sum(axis=1)
    squares = np.bincount(index, residual**2, len(anchors)) + params.noise_weight * noise2
    return Calibration(
        ref_level_dbm=m[:, 0],
        path_loss_exponent=m[:, 1],
        shadowing_db=np.sqrt(squares / (count + params.noise_weight)),
        readings=count,
        offset_db=offset,
        determined_share=_determined_share(S / noise2, spread),
        mean_ref_level_dbm=float(mean[0]),
        mean_exponent=float(mean[1]),
        residual_db=float(np.sqrt(np.mean(residual**2))),
    )


def calibrated(anchors: Sequence[Anchor], calibration: Calibration) -> tuple[Anchor, ...]:
    """Return the anchors with the level models that were found."""
    return tuple(
        replace(
            anchor,
            ref_level_dbm=float(calibration.ref_level_dbm[i]),
            path_loss_exponent=float(calibration.path_loss_exponent[i]),
            shadowing_db=float(calibration.shadowing_db[i]),
        )
        for i, anchor in enumerate(anchors)
    )


def residuals_db(
    levels: LabelledLevels,
    anchors: Sequence[Anchor],
    calibration: Calibration,
    params: CalibrationParams,
) -> FloatArray:
    """Return each level (readings,) less what its anchor's model and phone's offset expect."""
    x = _regressors(levels, anchors, params.phone_height_m)
    models = np.column_stack([calibration.ref_level_dbm, calibration.path_loss_exponent])
    offset_db = calibration.offset_db[levels.phone_index]
    expected_dbm = (x * models[levels.anchor_index]).sum(axis=1) + offset_db
    return np.asarray(levels.rssi_dbm - expected_dbm)


def _regressors(
    levels: LabelledLevels, anchors: Sequence[Anchor], phone_height_m: float
) -> FloatArray:
    """Return ``(1, -10 log10(d / d*))`` of each reading, (readings, 2)."""
    places = np.array([(a.x_m, a.y_m, a.z_m - phone_height_m, a.ref_distance_m) for a in anchors])
    x_m, y_m, dz_m, reference_m = places[levels.anchor_index].T
    distance_m = np.sqrt((levels.x_m - x_m) ** 2 + (levels.y_m - y_m) ** 2 + dz_m**2)
    decades = np.log10(np.maximum(distance_m, NEAR_FIELD_M) / reference_m)
    return np.column_stack([np.ones(len(decades)), -10.0 * decades])


def _determined_share(information: FloatArray, spread: FloatArray) -> FloatArray:
    """Return how much less than the spread (2, 2) is open after the anchors' own readings."""
    V = np.linalg.inv(information + np.linalg.inv(spread))
    return np.asarray(1.0 - np.diagonal(V, axis1=1, axis2=2) / np.diag(spread))


def _sums(group: IntArray, values: FloatArray, groups: int) -> FloatArray:
    """Return the sum of values (n, ...) over each group."""
    sums = np.zeros((groups, *values.shape[1:]))
    np.add.at(sums, group, values)
    return sums


def _offsets(left_db: FloatArray, phone: IntArray, shrinkage: float) -> FloatArray:
    """Return what each phone hears more than its anchors' models, shrunk, without their mean."""
    count = np.bincount(phone)
    offset = np.bincount(phone, left_db) / (count + shrinkage)
    return np.asarray(offset - offset @ count / count.sum())


def _bounded(
    m: FloatArray, readings: tuple[IntArray, FloatArray, FloatArray], params: CalibrationParams
) -> FloatArray:
    """Return the models with exponents in bounds; a level moves so that its readings fit."""
    index, x, own_dbm = readings
    exponent = np.clip(m[:, 1], params.min_exponent, params.max_exponent)
    level = m[:, 0].copy()
    for i in np.flatnonzero(exponent != m[:, 1]):
        of_anchor = index == i
        if of_anchor.any():
            level[i] = np.mean(own_dbm[of_anchor] - x[of_anchor, 1] * exponent[i])
    return np.column_stack([level, exponent])
