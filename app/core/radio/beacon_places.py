"""Places of beacons that nobody measured, from levels heard at known places.

Equation
--------
Beacon i at the unknown place g, heard with level ``u_j`` at place ``p_j``, ``x_j(g) = (1, -10
log10 |p_j - g|)``::

    u_j = x_j(g)' m_i + e_j,    m_i = (u*_i, n_i) ~ N(m, T),    e_j ~ t_nu(0, sigma)

Level and exponent are integrated out, so that the posterior over a grid of places is, with ``r =
u - X m``, ``A = X' W X`` and ``b = X' W r``::

    -2 log p(g | u) = r' W r - b' (A + T^-1)^-1 b + log det (I + T A)
    W_jj = (nu + 1) / (nu + e_j^2 / sigma^2) / sigma^2 / (1 + sum_{k != j} R(|p_j - p_k|))

The first factor is the weight of the Student-t (shadowing has heavier tails than the normal: a
shelf or a body between phone and beacon takes 10 dB), from the residuals at the mean place of the
round before. The last one is Kish's design effect: shadowing is fixed to the place and alike
nearby, so a hundred levels of one room tell not much more than ten. ``R`` is the correlation of the
residuals by distance as it is found over all beacons; the levels are not decorrelated by it, for
that leaves the differences between neighbours only, and these are the least like the model.

The answer is the posterior's mean and covariance, first on
a coarse grid around all places where the beacon was heard, then on a fine one around the mean.

``m``, ``T`` and ``sigma`` are what the beacons have in common; they start at what is usual and are
estimated along, as in `app.core.radio.calibration`. Readings at one place must be one level (their
local mean), not many: repeated readings tell nothing new.

Sources: Bayes; Kish, "Survey Sampling", 1965 (the design effect); Lange, Little, Taylor, "Robust
statistical modeling using the t distribution", JASA 84, 1989 (the weights); Laird and Ware 1982
(what the beacons have in common).
"""

from dataclasses import dataclass

import numpy as np

from app.core.radio.calibration import LabelledLevels
from app.core.types import BoolArray, FloatArray, IntArray

COARSE_CELLS = 41
"""Cells per side of the first grid: a metre or two in a hall of some 60 m."""

FINE_CELLS = 31
"""Cells per side of the second grid, four standard deviations to each side: a quarter of one."""

FINE_SIGMAS = 4.0

MIN_SIGMA_M = 0.3
"""No survey knows its own places better, so no beacon's place either."""

ROUNDS = 4
"""Rounds over what the beacons have in common; later ones move places by centimetres."""

LAG_M, LAGS = 1.0, 8
"""Steps of distance in which the correlation of shadowing is looked at, and how many."""

MIN_LEVELS = 3
"""A place on the plane is two numbers, and the level a third."""


@dataclass(frozen=True, slots=True)
class BeaconPlacesParams:
    """What is believed before anything is heard.

    Attributes
    ----------
    margin_m
        Beacons hang at most so far outside the places where they were heard.
    height_m
        Usual height of a beacon above the phone: hung on the ceiling, or on a wall over heads.
    level_dbm, level_spread_db
        Usual level at 1 m: BLE beacons send 0 to -12 dBm, of which some 60 dB are lost on the first
        metre in a hand.
    exponent, exponent_spread_ratio
        Usual path-loss exponent: 1.6 along corridors to 3.5 through walls.
    noise_db
        Usual shadowing, standard deviation.
    student_dof
        Of the Student-t: 4 has outliers of the size that shelves make.
    spread_weight
        Beacons' worth of those beliefs in what is estimated of them.
    noise_weight
        Levels' worth of the floor's noise in a beacon's own.
    """

    margin_m: float = 8.0
    height_m: float = 1.2
    level_dbm: float = -62.0
    level_spread_db: float = 6.0
    exponent: float = 2.2
    exponent_spread_ratio: float = 0.5
    noise_db: float = 5.0
    student_dof: float = 4.0
    spread_weight: float = 4.0
    noise_weight: float = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class BeaconPlaces:
    """Where beacons are and how they sound, each array (beacons, ...).

    Attributes
    ----------
    x_m, y_m
        Posterior mean, nan for beacons with fewer than `MIN_LEVELS` levels.
    covariance_m2 : (beacons, 2, 2)
        Of the place.
    ref_level_dbm, path_loss_exponent, shadowing_db
        Level model at that place, 1 m.
    levels
        How many told it.
    """

    x_m: FloatArray
    y_m: FloatArray
    covariance_m2: FloatArray
    ref_level_dbm: FloatArray
    path_loss_exponent: FloatArray
    shadowing_db: FloatArray
    levels: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Floor:
    """What beacons share: mean (2,) and spread (2, 2) of their models, noise (dB), R (lags,)."""

    mean: FloatArray
    spread: FloatArray
    noise_db: float
    correlation: FloatArray


@dataclass(slots=True, eq=False)
class _Beacon:
    """One beacon's levels with their weights, and what is known of it so far."""

    places: FloatArray
    level_dbm: FloatArray
    weight: FloatArray
    lag: IntArray
    mean: FloatArray
    covariance: FloatArray
    model: FloatArray
    model_covariance: FloatArray
    residual_db: FloatArray


def beacon_places(levels: LabelledLevels, beacons: int, params: BeaconPlacesParams) -> BeaconPlaces:
    """Return where beacons are that were heard at known places.

    Parameters
    ----------
    levels
        ``anchor_index`` counts the beacons; ``phone_index`` is not looked at: take the phones'
        offsets off before.
    beacons
        How many there are.
    """
    count = np.bincount(levels.anchor_index, minlength=beacons)
    floor = _Floor(
        np.array([params.level_dbm, params.exponent]),
        np.diag([params.level_spread_db**2, params.exponent_spread_ratio**2]),
        params.noise_db,
        np.zeros(LAGS + 1),
    )
    placed = np.flatnonzero(count >= MIN_LEVELS)
    of_beacon = {int(i): _beacon(levels, levels.anchor_index == i) for i in placed}
    for _ in range(ROUNDS):
        for beacon in of_beacon.values():
            _locate(beacon, floor, params)
        if of_beacon:
            floor = _floor_of(list(of_beacon.values()), params)
    return _gathered(of_beacon, count, floor, params)


def _beacon(levels: LabelledLevels, own: BoolArray) -> _Beacon:
    places = np.column_stack([levels.x_m[own], levels.y_m[own]])
    level_dbm = levels.rssi_dbm[own]
    apart_m = np.linalg.norm(places[:, None] - places[None], axis=2)
    lag = np.minimum(apart_m / LAG_M, LAGS).astype(np.int64)
    return _Beacon(
        places,
        level_dbm,
        np.ones(len(level_dbm)),
        lag,
        np.zeros(2),
        np.eye(2),
        np.zeros(2),
        np.eye(2),
        np.zeros(len(level_dbm)),
    )


def _locate(beacon: _Beacon, floor: _Floor, params: BeaconPlacesParams) -> None:
    """Find the place and the model with the present weights, and the next weights from them."""
    low = beacon.places.min(axis=0) - params.margin_m
    high = beacon.places.max(axis=0) + params.margin_m
    for cells in (COARSE_CELLS, FINE_CELLS):
        grid = _grid(low, high, cells)
        cost = _cost(beacon, grid, floor, params.height_m)
        weight = np.exp(0.5 * (cost.min() - cost))
        weight /= weight.sum()
        beacon.mean = weight @ grid
        off = grid - beacon.mean
        # A posterior narrower than a cell is not narrower than that.
        own_cell = np.diag(((high - low) / (cells - 1)) ** 2 / 12.0)
        beacon.covariance = (weight[:, None] * off).T @ off + own_cell
        sigma = np.sqrt(np.diagonal(beacon.covariance))
        low = np.maximum(low, beacon.mean - FINE_SIGMAS * sigma)
        high = np.minimum(high, beacon.mean + FINE_SIGMAS * sigma)
    x = _regressors(beacon.places, beacon.mean[None], params.height_m)[0]
    wx, precision = x * _information(beacon, floor)[:, None], np.linalg.inv(floor.spread)
    beacon.model_covariance = np.linalg.inv(x.T @ wx + precision)
    told = wx.T @ beacon.level_dbm + precision @ floor.mean
    beacon.model = beacon.model_covariance @ told
    beacon.residual_db = beacon.level_dbm - x @ beacon.model
    nu = params.student_dof
    beacon.weight = (nu + 1.0) / (nu + (beacon.residual_db / floor.noise_db) ** 2)


def _information(beacon: _Beacon, floor: _Floor) -> FloatArray:
    """Return the diagonal (levels,) of W."""
    others = floor.correlation[beacon.lag].sum(axis=1) - floor.correlation[0]
    return np.asarray(beacon.weight / floor.noise_db**2 / (1.0 + others))


def _cost(beacon: _Beacon, grid: FloatArray, floor: _Floor, height_m: float) -> FloatArray:
    """Return -2 log-posterior (places,) of the beacon at each place of a grid (places, 2)."""
    x, weight = _regressors(beacon.places, grid, height_m), _information(beacon, floor)
    r = beacon.level_dbm - x @ floor.mean
    wx = x * weight[:, None]
    A = np.swapaxes(x, 1, 2) @ wx
    b = np.einsum("gjk,gj->gk", wx, r)
    inner = A + np.linalg.inv(floor.spread)
    explained = np.einsum("gk,gk->g", b, np.linalg.solve(inner, b[..., None])[..., 0])
    volume = np.log(np.linalg.det(np.eye(2) + floor.spread @ A))
    return np.asarray((weight * r**2).sum(axis=1) - explained + volume)


def _regressors(places: FloatArray, grid: FloatArray, height_m: float) -> FloatArray:
    """Return ``(1, -10 log10 d)`` (grid, places, 2) of levels at places from each grid place."""
    squared = np.square(places[None] - grid[:, None]).sum(axis=2) + height_m**2
    decades = 0.5 * np.log10(np.maximum(squared, MIN_SIGMA_M**2))
    return np.stack([np.ones_like(decades), -10.0 * decades], axis=-1)


def _grid(low: FloatArray, high: FloatArray, cells: int) -> FloatArray:
    x, y = (np.linspace(a, b, cells) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _floor_of(beacons: list[_Beacon], params: BeaconPlacesParams) -> _Floor:
    """Return what the beacons found have in common, with the usual as some beacons' worth."""
    models = np.array([beacon.model for beacon in beacons])
    usual = np.array([params.level_dbm, params.exponent])
    weight, total = params.spread_weight, len(beacons) + params.spread_weight
    mean = (models.sum(axis=0) + weight * usual) / total
    apart = models - mean
    found = apart.T @ apart + np.sum([beacon.model_covariance for beacon in beacons], axis=0)
    spread = weight * np.diag([params.level_spread_db**2, params.exponent_spread_ratio**2])
    squares = sum(float(b.weight @ b.residual_db**2) for b in beacons)
    levels = sum(len(b.level_dbm) for b in beacons)
    noise2 = (squares + params.noise_weight * params.noise_db**2) / (levels + params.noise_weight)
    return _Floor(mean, (found + spread) / total, float(np.sqrt(noise2)), _correlation(beacons))


def _correlation(beacons: list[_Beacon]) -> FloatArray:
    """Return the correlation (lags + 1,) of residuals by distance; far apart there is none."""
    products, pairs, square, levels = np.zeros(LAGS + 1), np.zeros(LAGS + 1), 0.0, 0
    for beacon in beacons:
        robust_db = beacon.residual_db * np.sqrt(beacon.weight)
        apart = ~np.eye(len(robust_db), dtype=np.bool_)
        lag = beacon.lag[apart]
        products += np.bincount(lag, np.outer(robust_db, robust_db)[apart], LAGS + 1)
        pairs += np.bincount(lag, minlength=LAGS + 1)
        square, levels = square + float(robust_db @ robust_db), levels + len(robust_db)
    found = products / np.maximum(pairs, 1.0) / (square / levels)
    found[LAGS] = 0.0
    return np.clip(found, 0.0, 1.0)


def _gathered(
    of_beacon: dict[int, _Beacon], count: IntArray, floor: _Floor, params: BeaconPlacesParams
) -> BeaconPlaces:
    beacons = len(count)
    found = BeaconPlaces(
        np.full(beacons, np.nan),
        np.full(beacons, np.nan),
        np.full((beacons, 2, 2), np.nan),
        np.full(beacons, floor.mean[0]),
        np.full(beacons, floor.mean[1]),
        np.full(beacons, floor.noise_db),
        count,
    )
    for i, beacon in of_beacon.items():
        found.x_m[i], found.y_m[i] = beacon.mean
        found.covariance_m2[i] = beacon.covariance + MIN_SIGMA_M**2 * np.eye(2)
        found.ref_level_dbm[i], found.path_loss_exponent[i] = beacon.model
        squares = beacon.residual_db @ beacon.residual_db + params.noise_weight * floor.noise_db**2
        found.shadowing_db[i] = np.sqrt(squares / (count[i] + params.noise_weight))
    return found
