"""Extended Kalman filter on the place alone: carried by steps, corrected by ranges to beacons.

Equation
--------
State ``p = (x, y)``, control the displacement ``d`` of a step, measurements the ranges ``r_i`` that
the path-loss model gives for the levels of the beacons heard (at ``b_i``, ``dz_i`` higher)::

    p' = p + d,    P' = P + Q
    h_i(p) = sqrt(|p - b_i|^2 + dz_i^2),    H_i = (p - b_i)' / h_i
    P  = (P'^-1 + sum H_i' H_i / R_i)^-1
    p  = p' + P sum H_i' (r_i - h_i(p')) / R_i

A level deviates from the model by a normal ``e`` of sigma dB, so with ``L = 10 n / ln 10`` dB per
neper of distance the range is ``r = h exp(-e / L)``: log-normal, of standard deviation (first
order) ``sigma_r = (sigma / L) r``. It grows with the distance: 4.11 dB at n = 2 are 47 % of it.
So ``R_i = (sigma r_i / L_i)^2``, with a floor for beacons close by.

The step's noise ``Q`` is a share of its length along it and the heading's error across it.

The filter has no heading bias, no step scale and no gate: it is the published one, and its faults
(a drift that nothing but ranges corrects, ranges through a wall taken for ranges) are part of it.

Source: Nguyen Ngoc Khuong, "BluNavi: an indoor positioning and navigation system", Haiphong
University Journal of Science 44, 2021 (sigma = 4.11 dB); the printed filter is the textbook's.
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.fusion.planar import PlanarTrack
from app.core.types import FloatArray

_AT_BEACON_M = 1e-6
"""Closer to a beacon no direction is told apart; only keeps the division finite."""


@dataclass(frozen=True, slots=True)
class RangeEkfParams:
    """Parameters of the range filter.

    Attributes
    ----------
    shadowing_db
        Deviation of levels around the path-loss model, as published.
    least_range_sigma_m
        Bound of a range's deviation: neither phone nor beacon is known better, and the model ends
        in the near field.
    along_share
        Error of a step's length, as a share of it: trained step lengths are within 5 to 10 %.
    heading_rad
        Error of a step's heading: 8 degrees for a phone in the hand (measured on ms2020).
    """

    shadowing_db: float = 4.11
    least_range_sigma_m: float = 0.5
    along_share: float = 0.1
    heading_rad: float = 0.14


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """Ranges to some beacons at one time.

    Attributes
    ----------
    places : (n, 2)
        Where the beacons are.
    dz2_m2 : (n,)
        Squares of their height over the phone.
    range_m, sigma_m : (n,)
        Distances in space, and their standard deviations.
    """

    places: FloatArray
    dz2_m2: FloatArray
    range_m: FloatArray
    sigma_m: FloatArray


def range_sigma_m(range_m: FloatArray, slope_db: FloatArray, params: RangeEkfParams) -> FloatArray:
    """Return the standard deviation of ranges, ``sigma r / L``, bounded from below.

    Parameters
    ----------
    range_m : (n,)
        Ranges that the levels give.
    slope_db : (n,)
        ``L`` above, dB per neper (`LevelModel.table`, column ``SLOPE``).
    """
    grown_m = params.shadowing_db / slope_db * range_m
    return np.asarray(np.maximum(grown_m, params.least_range_sigma_m))


def carried(
    track: PlanarTrack, length_m: float, heading_rad: float, params: RangeEkfParams
) -> PlanarTrack:
    """Return the track after a step; with an unknown heading (nan) it only widens."""
    if math.isnan(heading_rad):
        return PlanarTrack(track.mean, track.covariance + 0.5 * length_m**2 * np.eye(2))
    ahead = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    aside = np.array([-ahead[1], ahead[0]])
    along_m, across_m = params.along_share * length_m, params.heading_rad * length_m
    noise = along_m**2 * np.outer(ahead, ahead) + across_m**2 * np.outer(aside, aside)
    return PlanarTrack(track.mean + length_m * ahead, track.covariance + noise)


def corrected(track: PlanarTrack, ranges: Ranges) -> PlanarTrack:
    """Return the track after ranges, all linearised about the same place: their order is free."""
    away = track.mean - ranges.places
    expected_m = np.sqrt((away**2).sum(axis=1) + ranges.dz2_m2)
    # Right at a beacon the range has no direction; the row is 0 then.
    H = away / np.maximum(expected_m, _AT_BEACON_M)[:, None]
    weighted = H / np.square(ranges.sigma_m)[:, None]
    covariance = np.linalg.inv(np.linalg.inv(track.covariance) + weighted.T @ H)
    covariance = 0.5 * (covariance + covariance.T)
    return PlanarTrack(
        track.mean + covariance @ (weighted.T @ (ranges.range_m - expected_m)), covariance
    )


def pulled(track: PlanarTrack, place: FloatArray, noise_m2: FloatArray) -> PlanarTrack:
    """Return the track after a place (2,) of covariance (2, 2): a fingerprint's correction."""
    gain = track.covariance @ np.linalg.inv(track.covariance + noise_m2)
    covariance = track.covariance - gain @ track.covariance
    return PlanarTrack(track.mean + gain @ (place - track.mean), 0.5 * (covariance + covariance.T))
