"""Where a surveyor was between the waypoints of a walk: dead reckoning, tied to every waypoint.

The straight way in time from waypoint to waypoint is wrong where the surveyor slowed down, stood,
or went round a corner. The strides of the walk know: turned and scaled as a whole so that they run
from waypoint to waypoint as well as they can, then smoothed (`app.core.fusion.smoother`) with each
waypoint as a sighting that is all but exact. With d_i the way between two waypoints and r_i the sum
of the strides in between, as complex numbers::

    turn = arg sum_i d_i conj(r_i),    scale = sum_i |d_i| / sum_i |r_i|

so neither the direction in which the phone was held nor where the plan has north matters. Between
two waypoints without enough strides nothing is known but the straight way.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from app.core.fusion.sighting import Sighting
from app.core.fusion.smoother import Leg, Path, smooth
from app.core.params import SmootherParams
from app.core.types import BoolArray, FloatArray, IntArray


def _tied() -> SmootherParams:
    # Nobody walks through these waypoints but the surveyor: no outliers, no second candidates.
    return SmootherParams(passes=1, noise_ratio=1.0)


@dataclass(frozen=True, slots=True)
class SurveyWalkParams:
    """How a walk is placed.

    Attributes
    ----------
    smoother
        How far its strides are believed; the waypoints are.
    waypoint_m
        How exactly a surveyor stands on a waypoint.
    least_stride_share
        Strides that sum up to a smaller share of the way between two waypoints missed some of it.
    stride_s
        A stride takes no longer; before it the surveyor stood.
    """

    smoother: SmootherParams = field(default_factory=_tied)
    waypoint_m: float = 0.3
    least_stride_share: float = 0.5
    stride_s: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PlacedWalk:
    """Where the surveyor was, straight in time between knots.

    Attributes
    ----------
    time_s : (n,), place : (n, 2)
        Knots, site frame.
    """

    time_s: FloatArray
    place: FloatArray

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the place at a time; before the first and after the last knot, theirs."""
        return (
            float(np.interp(time_s, self.time_s, self.place[:, 0])),
            float(np.interp(time_s, self.time_s, self.place[:, 1])),
        )


def straight_walk(waypoints: FloatArray) -> PlacedWalk:
    """Return the walk that goes straight, at one speed, from waypoint to waypoint.

    Parameters
    ----------
    waypoints : (n, 3)
        Time (s), x and y (m, site frame), in time order; n >= 1.
    """
    return PlacedWalk(waypoints[:, 0], waypoints[:, 1:])


def smoothed_walk(
    strides: FloatArray, waypoints: FloatArray, params: SurveyWalkParams
) -> PlacedWalk:
    """Return the walk along its strides through its waypoints.

    Parameters
    ----------
    strides : (n, 3)
        Time (s), length (m) and heading (rad, counter-clockwise, from whatever direction) of each
        step, in time order; those without a heading (nan) are left out.
    waypoints : (m, 3)
        As in `straight_walk`.
    """
    strides = strides[np.isfinite(strides[:, 2])]
    first = np.searchsorted(strides[:, 0], waypoints[:, 0], side="right")
    followed = _followed(strides, waypoints, first, params)
    if not followed.any():
        return straight_walk(waypoints)
    taken = _aligned(strides, waypoints, first, followed)[first[0] : first[-1]]
    legs = sorted(
        [*_stride_legs(taken), *_waypoint_legs(waypoints, followed, params)],
        key=lambda leg: (leg.time_s, leg.sighting is not None),
    )
    straight = straight_walk(waypoints)
    guess = np.array([straight.at(leg.time_s) for leg in legs])
    path = smooth(legs, Path(guess, np.zeros((len(legs), 2, 2))), params.smoother)
    told = np.repeat(followed, np.diff(first))
    return _knotted(legs, path.place, told, params.stride_s)


def _followed(
    strides: FloatArray, waypoints: FloatArray, first: IntArray, params: SurveyWalkParams
) -> BoolArray:
    """Return whether the strides between each two waypoints can have been all of the way."""
    walked_m = np.concatenate([[0.0], np.cumsum(strides[:, 1])])[first]
    way_m = np.linalg.norm(np.diff(waypoints[:, 1:], axis=0), axis=1)
    return np.asarray(np.diff(walked_m) > params.least_stride_share * way_m)


def _aligned(
    strides: FloatArray, waypoints: FloatArray, first: IntArray, followed: BoolArray
) -> FloatArray:
    """Return the strides, turned and scaled as a whole onto the waypoints."""
    time_s, length_m, heading_rad = strides.T
    ends = np.concatenate([[0.0], np.cumsum(length_m * np.exp(1j * heading_rad))])
    run = np.diff(ends[first])[followed]
    way = np.diff(waypoints[:, 1] + 1j * waypoints[:, 2])[followed]
    run_m, way_m = float(np.abs(run).sum()), float(np.abs(way).sum())
    # A surveyor who goes nowhere tells neither.
    scale = way_m / run_m if way_m and run_m else 1.0
    turn = float(np.angle((way * np.conj(run)).sum()))
    return np.column_stack([time_s, length_m * scale, heading_rad + turn])


def _stride_legs(strides: FloatArray) -> Iterator[Leg]:
    for row in strides:
        yield Leg(float(row[0]), row[1:2], row[2:3], 0.0, None, None)


def _waypoint_legs(
    waypoints: FloatArray, followed: BoolArray, params: SurveyWalkParams
) -> Iterator[Leg]:
    none, noise_m2 = np.empty(0), (params.waypoint_m**2, 0.0, params.waypoint_m**2)
    way_m2 = np.square(np.diff(waypoints[:, 1:], axis=0)).sum(axis=1)
    # A way that the strides do not tell may have been any; it must not bend those around it.
    drift_m2 = [0.0, *np.where(followed, 0.0, way_m2).tolist()]
    for (time_s, x_m, y_m), drift in zip(waypoints.tolist(), drift_m2, strict=True):
        sighting = Sighting(time_s, np.array([[x_m, y_m]]), np.ones(1), noise_m2, np.ones(1))
        yield Leg(time_s, none, none, drift, sighting, None)


def _knotted(legs: list[Leg], place: FloatArray, told: BoolArray, stride_s: float) -> PlacedWalk:
    """Return the walk that stands still but during its strides; those not ``told`` are left out."""
    knots: list[tuple[float, FloatArray]] = []
    stride = 0
    for i, leg in enumerate(legs):
        if leg.sighting is None:
            stride += 1
            if not told[stride - 1]:
                continue
            knots.append((max(leg.time_s - stride_s, knots[-1][0]), place[i - 1]))
        knots.append((leg.time_s, place[i]))
    return PlacedWalk(np.array([t for t, _ in knots]), np.array([xy for _, xy in knots]))
