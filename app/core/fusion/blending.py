"""Blending of speed and heading: what was, what Wi-Fi says and what the sensors say, weighted.

Equations
---------
At each Wi-Fi fix F, dt seconds after the last output P, with e(O) = (cos O, sin O)::

    O_wifi = direction of F - P
    O = direction of u1 e(O_last) + u2 e(O_wifi) + u3 e(O_sensor)
    V_wifi = (F - P) . e(O) / dt,   V_sensor = V_last + a dt
    V = w1 V_last + w2 V_wifi + w3 V_sensor
    P' = P + V dt e(O)

``V_wifi`` is the speed along the walker's heading that would carry the last output to the fix: how
the paper takes it is not known to us. Taken as the length of F - P it is never negative, and a fix
behind the walker pushes him on: with a fix a second that diverges. Taken between two fixes it never
corrects the place. A source that says nothing (nan) is left out of the heading. Where steps are
counted, they tell ``V_sensor`` themselves.

Source: Liu, Jiang, Liu, Chen, "Multi-sensor fusion based indoor real-time and highly accurate
trajectory generation", Computer Science 43(1), 2016.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

Three: TypeAlias = tuple[float, float, float]
"""Of the last value, of Wi-Fi and of the sensors."""

_NONE_YET: Three = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class BlendingParams:
    """The published weights.

    Attributes
    ----------
    speed_weights, heading_weights
        w and u. The speed's sum to 0.88, so that a walker blended with them lags behind his fixes.
    """

    speed_weights: Three = (0.2, 0.38, 0.3)
    heading_weights: Three = (0.01, 0.01, 0.98)


@dataclass(frozen=True, slots=True)
class BlendedMotion:
    """Where the last output was, and how the walker moved to it.

    Attributes
    ----------
    time_s, x_m, y_m
        The last output at a fix.
    speed_mps, heading_rad
        V and O; the heading is nan while unknown.
    speeds, headings
        What they were blended of, m/s and radians; nan what was not known.
    walked_x_m, walked_y_m, strides
        What the pedometer has walked since, and in how many strides.
    filtered_s
        Time to which the filter behind it has moved on.
    """

    time_s: float
    x_m: float
    y_m: float
    speed_mps: float = 0.0
    heading_rad: float = math.nan
    speeds: Three = _NONE_YET
    headings: Three = _NONE_YET
    walked_x_m: float = 0.0
    walked_y_m: float = 0.0
    strides: int = 0
    filtered_s: float = -math.inf

    @property
    def velocity_mps(self) -> tuple[float, float]:
        """V e(O); zero while the heading is unknown."""
        if math.isnan(self.heading_rad):
            return 0.0, 0.0
        return (
            self.speed_mps * math.cos(self.heading_rad),
            self.speed_mps * math.sin(self.heading_rad),
        )


@dataclass(frozen=True, slots=True)
class WifiFix:
    """A place told by Wi-Fi alone."""

    time_s: float
    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class SensedMotion:
    """What the sensors tell of the time since the last fix.

    Attributes
    ----------
    heading_rad
        O_sensor; nan where no sensor tells it.
    acceleration_mps2
        Mean along the heading; 0 where no accelerometer is at hand: the last speed stands.
    speed_mps
        V_sensor where steps tell it; None: it is the last speed plus what acceleration adds.
    """

    heading_rad: float
    acceleration_mps2: float = 0.0
    speed_mps: float | None = None


def blended(
    motion: BlendedMotion, fix: WifiFix, sensed: SensedMotion, params: BlendingParams
) -> BlendedMotion:
    """Return the motion after a Wi-Fi fix later than the last output, dead reckoned to its time."""
    seconds = fix.time_s - motion.time_s
    dx, dy = fix.x_m - motion.x_m, fix.y_m - motion.y_m
    headings = (motion.heading_rad, math.atan2(dy, dx), sensed.heading_rad)
    heading_rad = blended_heading_rad(headings, params.heading_weights)
    speeds = (
        motion.speed_mps,
        (dx * math.cos(heading_rad) + dy * math.sin(heading_rad)) / seconds,
        _sensed_mps(motion, sensed, seconds),
    )
    moved = BlendedMotion(
        time_s=fix.time_s,
        x_m=motion.x_m,
        y_m=motion.y_m,
        speed_mps=sum(w * v for w, v in zip(params.speed_weights, speeds, strict=True)),
        heading_rad=heading_rad,
        speeds=speeds,
        headings=headings,
        filtered_s=motion.filtered_s,
    )
    vx, vy = moved.velocity_mps
    return replace(moved, x_m=moved.x_m + vx * seconds, y_m=moved.y_m + vy * seconds)


def blended_heading_rad(headings: Sequence[float], weights: Three) -> float:
    """Return the direction of the weighted sum of unit vectors, those of nan left out."""
    known = [(h, w) for h, w in zip(headings, weights, strict=True) if not math.isnan(h)]
    x = sum(w * math.cos(h) for h, w in known)
    y = sum(w * math.sin(h) for h, w in known)
    return math.atan2(y, x)


def _sensed_mps(motion: BlendedMotion, sensed: SensedMotion, seconds: float) -> float:
    if sensed.speed_mps is not None:
        return sensed.speed_mps
    return accelerated_mps(motion.speed_mps, sensed.acceleration_mps2, seconds)


def accelerated_mps(speed_mps: float, acceleration_mps2: float, seconds: float) -> float:
    """Return V_sensor of an accelerometer: ``V_last + a dt``."""
    return speed_mps + acceleration_mps2 * seconds
