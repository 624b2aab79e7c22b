"""Hidden Markov model over the cells of a map: what was walked, and what is heard on the way.

Equation
--------
State: the cell c. Between two scans a displacement ``d`` was measured (of covariance ``D``)::

    T(c, c') = (1 - e) s^2 N(x_c' - x_c - d; 0, D) + e / cells

``s`` is the cell's edge, and N is 0 between floors. T is a likelihood, its rows do not sum to one:
who would have walked off the map loses weight against who stayed on it, as it should be. A
scan with levels ``u_t`` gives cell c, with ``m, v, h`` the mean, deviation and share of scans that
heard t there, and ``b`` a background that stands for whatever the survey did not meet::

    L(c) = product of (h N(u_t; m, v) + b) over t heard, times (1 - h) over t not heard

    forward:   a'(c') ~ L(c')^w sum_c T(c, c') a(c)
    backward:  r(c) ~ sum_c' T(c, c') L(c')^w r(c'),    smoothed ~ a(c) r(c)

``w`` < 1 since what one scan hears deviates alike (the body, the hand, a door), and so do scans
that follow each other. ``e`` lets a belief that went wrong start anew.

Sources: Rabiner, "A tutorial on hidden Markov models", Proceedings of the IEEE 77(2), 1989; the
model over fingerprint cells is future work in Nguyen Ngoc Khuong, "BluNavi", Haiphong University
Journal of Science 44, 2021.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.derived import derived
from app.core.fingerprint.cells import CellMap
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class HmmParams:
    """Parameters of the hidden Markov model.

    Attributes
    ----------
    restart_probability
        ``e``: one scan in a hundred finds the belief elsewhere altogether.
    along_share, heading_rad
        Error of the displacement along (share of it) and across.
    least_sigma_m
        Its error before anything is walked: a phone is anywhere in its cell (0.29 of the edge per
        axis, at either end), and sways.
    background_share
        Share of levels that come from anywhere between -100 and -30 dBm.
    most_heard_share
        Bound of ``h``: a transmitter heard in all of two survey scans may well be missed.
    evidence_weight
        ``w`` above.
    """

    restart_probability: float = 0.01
    along_share: float = 0.1
    heading_rad: float = 0.15
    least_sigma_m: float = 1.3
    background_share: float = 0.05
    most_heard_share: float = 0.9
    evidence_weight: float = 0.4


_LEVEL_RANGE_DB = 70.0
"""Levels lie between -100 and -30 dBm."""

_NEGLIGIBLE = 1e-6
"""Cells less probable than this are not walked from: a thousand of them weigh less than ``e``."""


@dataclass(frozen=True, slots=True, eq=False)
class Walked:
    """Displacement between two scans.

    Attributes
    ----------
    displacement_m : (2,)
        x and y.
    covariance_m2 : (2, 2)
        Its error.
    """

    displacement_m: FloatArray
    covariance_m2: FloatArray


def stood(params: HmmParams) -> Walked:
    """Return the displacement of who took no step."""
    return Walked(np.zeros(2), params.least_sigma_m**2 * np.eye(2))


def with_step(walked: Walked, length_m: float, heading_rad: float, params: HmmParams) -> Walked:
    """Return the displacement after a further step; an unknown heading (nan) only widens it."""
    if math.isnan(heading_rad):
        wider = walked.covariance_m2 + 0.5 * length_m**2 * np.eye(2)
        return Walked(walked.displacement_m, wider)
    ahead = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    aside = np.array([-ahead[1], ahead[0]])
    noise = np.outer(ahead, ahead) * (params.along_share * length_m) ** 2
    noise += np.outer(aside, aside) * (params.heading_rad * length_m) ** 2
    return Walked(walked.displacement_m + length_m * ahead, walked.covariance_m2 + noise)


def anywhere(cells: CellMap) -> FloatArray:
    """Return the belief (cells,) before anything is heard."""
    return np.full(cells.cells, 1.0 / max(cells.cells, 1))


def log_emission(
    column: IntArray, rssi_dbm: FloatArray, cells: CellMap, params: HmmParams
) -> FloatArray:
    """Return ``w ln L`` of every cell (cells,).

    Parameters
    ----------
    column, rssi_dbm : (transmitters,)
        What is heard, as columns of the map.
    """
    silence = _log_silence(cells, params)
    background = math.log(params.background_share / _LEVEL_RANGE_DB)
    inverted = (cells.column_start, cells.column_entry, cells.column_cell)
    levels = (cells.mean_dbm, cells.deviation_db, cells.heard_share)
    bounds = (params.most_heard_share, params.background_share / _LEVEL_RANGE_DB)
    heard = _heard(column, rssi_dbm, inverted, levels, (*bounds, float(cells.cells)))
    return np.asarray(params.evidence_weight * (silence + len(column) * background + heard))


def predicted(belief: FloatArray, walked: Walked, cells: CellMap, params: HmmParams) -> FloatArray:
    """Return the belief (cells,) after what was walked."""
    spread = _transited(belief, walked.displacement_m, walked.covariance_m2, (cells, params))
    return np.asarray(spread / spread.sum())


def updated(belief: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Return the belief (cells,) after a scan."""
    posterior = belief * np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(posterior / posterior.sum())


def smoothed(
    log_likelihoods: Sequence[FloatArray],
    walked: Sequence[Walked],
    cells: CellMap,
    params: HmmParams,
) -> list[FloatArray]:
    """Return the belief (cells,) at every scan, given all of them.

    Parameters
    ----------
    log_likelihoods
        Of each scan (`log_emission`).
    walked
        Displacement before each scan; the first one is not used.
    """
    forward: list[FloatArray] = []
    for log_likelihood, step in zip(log_likelihoods, walked, strict=True):
        prior = predicted(forward[-1], step, cells, params) if forward else anywhere(cells)
        forward.append(updated(prior, log_likelihood))
    out = list(forward)
    later = np.ones(cells.cells)
    for i in range(len(out) - 2, -1, -1):
        later = updated(later, log_likelihoods[i + 1])
        # T with c and c' swapped is T for the way back.
        step = walked[i + 1]
        later = _transited(later, -step.displacement_m, step.covariance_m2, (cells, params))
        out[i] = forward[i] * later / (forward[i] @ later)
    return out


def moments(belief: FloatArray, cells: CellMap) -> tuple[FloatArray, FloatArray]:
    """Return the mean place (2,) of a belief and its covariance (2, 2), the cell's own included.

    A belief spread over floors is taken on the most probable one.
    """
    floor = int(np.argmax(np.bincount(cells.floor_index, belief)))
    weight = np.where(cells.floor_index == floor, belief, 0.0)
    weight /= weight.sum()
    places = _places(cells)
    mean = weight @ places
    away = places - mean
    inside_m2 = cells.cell_m**2 / 12.0
    return mean, (weight[:, None] * away).T @ away + inside_m2 * np.eye(2)


def _transited(
    weight: FloatArray,
    displacement_m: FloatArray,
    covariance_m2: FloatArray,
    model: tuple[CellMap, HmmParams],
) -> FloatArray:
    cells, params = model
    inverse = np.linalg.inv(covariance_m2).astype(np.float64)
    scale = cells.cell_m**2 * math.sqrt(float(np.linalg.det(inverse))) / (2.0 * math.pi)
    out = np.zeros_like(weight)
    _spread(weight, (displacement_m, inverse), _places(cells), cells.floor_index, out)
    out *= scale * (1.0 - params.restart_probability)
    return np.asarray(out + params.restart_probability * weight.mean())


def _places(cells: CellMap) -> FloatArray:
    return np.column_stack([cells.surveyed_x_m, cells.surveyed_y_m])


@derived()
def _log_silence(cells: CellMap, params: HmmParams) -> FloatArray:
    """Return the logarithm of the probability (cells,) that nothing at all is heard."""
    cell = np.repeat(np.arange(cells.cells), np.diff(cells.row_start))
    share = np.minimum(cells.heard_share, params.most_heard_share)
    return np.bincount(cell, np.log1p(-share), cells.cells).astype(np.float64)


@njit(cache=True)
def _heard(
    column: IntArray,
    rssi_dbm: FloatArray,
    inverted: tuple[IntArray, IntArray, IntArray],
    levels: tuple[FloatArray, FloatArray, FloatArray],
    bounds: tuple[float, float, float],
) -> FloatArray:  # pragma: no cover - compiled
    column_start, column_entry, column_cell = inverted
    mean_dbm, deviation_db, heard_share = levels
    most, background, cells = bounds
    out = np.zeros(int(cells))
    for i in range(len(column)):
        for at in range(column_start[column[i]], column_start[column[i] + 1]):
            entry = column_entry[at]
            share = min(heard_share[entry], most)
            z = (rssi_dbm[i] - mean_dbm[entry]) / deviation_db[entry]
            density = math.exp(-0.5 * z * z) / (deviation_db[entry] * math.sqrt(2.0 * math.pi))
            # Relative to a cell that never heard it, and without that cell's silence.
            ratio = math.log(1.0 + share * density / background)
            out[column_cell[at]] += ratio - math.log(1.0 - share)
    return out


@njit(cache=True)
def _spread(
    weight: FloatArray,
    walked: tuple[FloatArray, FloatArray],
    places: FloatArray,
    floor_index: IntArray,
    out: FloatArray,
) -> None:  # pragma: no cover - compiled
    moved, inverse = walked
    least = _NEGLIGIBLE * weight.sum()
    for c in range(len(weight)):
        if weight[c] <= least:
            continue
        for to in range(len(weight)):
            if floor_index[to] == floor_index[c]:
                dx = places[to, 0] - places[c, 0] - moved[0]
                dy = places[to, 1] - places[c, 1] - moved[1]
                across = inverse[0, 1] * dx * dy
                apart = inverse[0, 0] * dx * dx + 2.0 * across + inverse[1, 1] * dy * dy
                out[to] += weight[c] * math.exp(-0.5 * apart)
