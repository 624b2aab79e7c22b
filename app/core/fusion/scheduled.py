"""Scheduled-variance Kalman filter: fingerprint fixes, a pedometer, and the angle between them.

Equation
--------
A random walk in the plane, steered by the pedometer, A = H = I::

    x' = x + R(D) u                 P' = P + q dt I
    K = P' (P' + R I)^-1            x = x' + K (F - x')
    P = (I - K) P' (I - K)^T + R K K^T

``u`` (m) is the displacement that the pedometer tells, ``R(D)`` turns it by the heading offset
``D`` (rad) onto the plan, ``F`` (m) is the fingerprint fix. What makes the system is the variance
``R`` (m²), scheduled anew for every fix. It compares ``u`` since the last fix with
``f = F - P_prev``, the way from the last output to this fix:

- no displacement: ``R_normal``, no penalty (the paper prints "R = 0" for the penalty);
- the fix did not move, or its direction disagrees strongly, or the pedometer claims over 30 km/h:
  999999, the fix is dropped and the pedometer goes on alone;
- in a turn: 5000;
- otherwise ``R_normal + 100 max(r^2, r^-2)`` with ``r = |u|^2 / |f|^2``: a fix counts most that is
  as far ahead as the pedometer went.

The heading offset is the running mean of the differences ``d_n = arg f - arg u``,
``D_n = (d_n + (n - 1) D_(n-1)) / n``, taken on the circle: ``D_(n-1) + wrap(d_n - D_(n-1)) / n``.
In the first 5 s and 6 steps it is only gathered: 0 is in force, and since no direction can be
judged yet, ``R = R_normal``. In a turn only differences within 30 degrees of it are gathered.

The paper asks whether the heading turns by over 13 degrees in this second or in the next two, and
so looks ahead, which a live filter cannot. Here a turn lasts from the fix at which it is seen until
2 s later: fixes lag behind the walker, so it is after the corner that they would cut it.

Source: Zhu, Wang, Chen, Fang, Zhang, "Fusion location algorithm based on Bluetooth and pedometer",
Packaging Engineering 39(5), 2018.
"""

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from app.core.fusion.planar import PlanarTrack
from app.core.geometry import wrap_angle

Vector: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ScheduledParams:
    """Parameters of the scheduled filter; as published where nothing else is said.

    Attributes
    ----------
    normal_m2
        ``R_normal``: a fix is off by 3 m on each axis.
    dropped_m2
        ``R`` of a fix that is not believed; no fix counts less. One hardly moves the track, but the
        variance grows while fixes are dropped: after half a minute they draw it back.
    turning_m2
        ``R`` in a turn, of fixes that do not disagree strongly ("small" difference in the paper).
    ratio_gain_m2
        Penalty of a fix whose way fits the pedometer's perfectly.
    implausible_mps
        30 km/h: no pedestrian.
    unmoved_m
        A fix this close to the last one did not move. Not in print: a fingerprint fix stays the
        same as long as the phone's levels do, to the rounding of the weights.
    disagreement_rad
        A larger angle between fix and pedometer is strong disagreement. Not in print: over a right
        angle the fix lies behind the walker, and following it would be a jump back.
    turn_rad, turn_s
        A turn: the pedometer's heading turned by more than 13 degrees from one fix to the next. It
        lasts for that fix and those of the next 2 s.
    turn_offset_rad
        In a turn, differences farther than 30 degrees from the heading offset do not count in it.
    gathering_s, gathering_steps
        The heading offset is in force once this much time has passed and this many steps were taken
        (the paper names one "or" the other; a phone that lay still has gathered nothing).
    process_m2ps
        ``q`` where ``R`` is scheduled. Not in print. It has to be of ``R``'s scale, which the
        penalties lift far over the variance of any fix: one that is 3 m ahead where 1.25 m were
        walked has ``R = 3300``, and with the pedometer's own 0.1 m²/s it would count by 0.5 %.
        Chosen on simulated walks (seeds 1000 to 1059); the error is flat from 1000 to 4000.
    quiet_process_m2ps
        ``q`` where ``R`` is ``R_normal``, in true scale: 0.3 m in a second, as of a step length off
        by 10 % and a direction off by 15 degrees.
    """

    normal_m2: float = 9.0
    dropped_m2: float = 999_999.0
    turning_m2: float = 5000.0
    ratio_gain_m2: float = 100.0
    implausible_mps: float = 30.0 / 3.6
    unmoved_m: float = 0.01
    disagreement_rad: float = math.pi / 2.0
    turn_rad: float = math.radians(13.0)
    turn_s: float = 2.0
    turn_offset_rad: float = math.radians(30.0)
    gathering_s: float = 5.0
    gathering_steps: int = 6
    process_m2ps: float = 2000.0
    quiet_process_m2ps: float = 0.1


@dataclass(frozen=True, slots=True)
class ScheduledMemory:
    """What the filter remembers beside its track.

    Attributes
    ----------
    began_s, told_s
        Time of the first and of the last fix.
    output_m, fix_m
        ``P_prev``, the track after the last fix; and that fix.
    walked_m, steps
        The pedometer's displacement since the last fix, as it told it (not turned); and its steps
        since the first one.
    heading_rad
        Direction of the pedometer's last displacement from one fix to the next; None before.
    turned_s
        When a turn was last seen; None before.
    offset_rad, offsets
        ``D_n`` and ``n``.
    """

    began_s: float
    told_s: float
    output_m: Vector
    fix_m: Vector
    walked_m: Vector = (0.0, 0.0)
    steps: int = 0
    heading_rad: float | None = None
    turned_s: float | None = None
    offset_rad: float = 0.0
    offsets: int = 0


@dataclass(frozen=True, slots=True)
class Comparison:
    """A fix beside the pedometer's displacement since the last one.

    Attributes
    ----------
    walked_m, led_m
        Lengths ``|u|`` and ``|f|``.
    elapsed_s
        Time since the last fix.
    difference_rad, disagreement_rad
        ``d_n`` and ``d_n - D``, wrapped; None where the pedometer or the fix did not move.
    is_turning
        Whether a turn was seen at this fix or less than ``turn_s`` before.
    """

    walked_m: float
    led_m: float
    elapsed_s: float
    difference_rad: float | None
    disagreement_rad: float | None
    is_turning: bool


def begin(
    fix_m: Vector, time_s: float, params: ScheduledParams
) -> tuple[PlanarTrack, ScheduledMemory]:
    """Return the filter after its first fix."""
    track = PlanarTrack(np.array(fix_m), params.normal_m2 * np.eye(2))
    return track, ScheduledMemory(time_s, time_s, fix_m, fix_m)


def offset_in_force_rad(memory: ScheduledMemory, time_s: float, params: ScheduledParams) -> float:
    """Return the angle by which the pedometer is turned: 0 while the offset is only gathered."""
    return 0.0 if _is_gathering(memory, time_s, params) else memory.offset_rad


def walk(
    track: PlanarTrack,
    memory: ScheduledMemory,
    stride: tuple[float, float, float],
    params: ScheduledParams,
) -> tuple[PlanarTrack, ScheduledMemory]:
    """Move the filter by one step.

    Parameters
    ----------
    stride
        Time (s), length (m) and heading (rad) as the pedometer tells them. A heading of nan only
        widens: the step went anywhere on a circle, by half its square on each axis.
    """
    time_s, length_m, heading_rad = stride
    memory = replace(memory, steps=memory.steps + 1)
    if math.isnan(heading_rad):
        wider = track.covariance + 0.5 * length_m**2 * np.eye(2)
        return PlanarTrack(track.mean, wider), memory
    x_m, y_m = memory.walked_m
    along = (x_m + length_m * math.cos(heading_rad), y_m + length_m * math.sin(heading_rad))
    turned_rad = heading_rad + offset_in_force_rad(memory, time_s, params)
    moved = track.mean + length_m * np.array([math.cos(turned_rad), math.sin(turned_rad)])
    return PlanarTrack(moved, track.covariance), replace(memory, walked_m=along)


def update(
    track: PlanarTrack,
    memory: ScheduledMemory,
    fix_m: Vector,
    time_s: float,
    params: ScheduledParams,
) -> tuple[PlanarTrack, ScheduledMemory]:
    """Correct the filter by a fix."""
    memory = _seen_turn(memory, time_s, params)
    comparison = compare(memory, fix_m, time_s, params)
    variance_m2, process_m2ps = params.normal_m2, params.quiet_process_m2ps
    if comparison.walked_m > 0.0 and not _is_gathering(memory, time_s, params):
        variance_m2 = scheduled_variance_m2(comparison, params)
        process_m2ps = params.process_m2ps
    predicted = track.covariance + process_m2ps * comparison.elapsed_s * np.eye(2)
    noise = variance_m2 * np.eye(2)
    gain = np.linalg.solve(predicted + noise, predicted).T
    mean = track.mean + gain @ (np.array(fix_m) - track.mean)
    kept = np.eye(2) - gain
    covariance = kept @ predicted @ kept.T + gain @ noise @ gain.T
    memory = replace(
        _gathered(memory, comparison, params),
        told_s=time_s,
        output_m=(float(mean[0]), float(mean[1])),
        fix_m=fix_m,
        walked_m=(0.0, 0.0),
    )
    return PlanarTrack(mean, 0.5 * (covariance + covariance.T)), memory


def scheduled_variance_m2(comparison: Comparison, params: ScheduledParams) -> float:
    """Return ``R`` of a fix once the heading offset is in force, m²."""
    walked_m, led_m = comparison.walked_m, comparison.led_m
    if walked_m == 0.0:
        return params.normal_m2
    disagreement_rad = comparison.disagreement_rad
    if (
        disagreement_rad is None
        or abs(disagreement_rad) > params.disagreement_rad
        or walked_m > params.implausible_mps * comparison.elapsed_s
    ):
        return params.dropped_m2
    if comparison.is_turning:
        return params.turning_m2
    ratio = (walked_m / led_m) ** 2
    penalty = params.ratio_gain_m2 * max(ratio**2, ratio**-2)
    return min(params.normal_m2 + penalty, params.dropped_m2)


def compare(
    memory: ScheduledMemory, fix_m: Vector, time_s: float, params: ScheduledParams
) -> Comparison:
    """Return a fix beside what the pedometer told since the last one."""
    led = (fix_m[0] - memory.output_m[0], fix_m[1] - memory.output_m[1])
    walked_m, led_m = math.hypot(*memory.walked_m), math.hypot(*led)
    moved_m = math.dist(fix_m, memory.fix_m)
    difference_rad = disagreement_rad = None
    if walked_m > 0.0 and led_m > 0.0 and moved_m > params.unmoved_m:
        difference_rad = wrap_angle(_direction_rad(led) - _direction_rad(memory.walked_m))
        disagreement_rad = wrap_angle(difference_rad - memory.offset_rad)
    return Comparison(
        walked_m=walked_m,
        led_m=led_m,
        elapsed_s=time_s - memory.told_s,
        difference_rad=difference_rad,
        disagreement_rad=disagreement_rad,
        is_turning=memory.turned_s is not None and time_s - memory.turned_s <= params.turn_s,
    )


def _is_gathering(memory: ScheduledMemory, time_s: float, params: ScheduledParams) -> bool:
    early = time_s - memory.began_s < params.gathering_s
    return early or memory.steps < params.gathering_steps


def _seen_turn(memory: ScheduledMemory, time_s: float, params: ScheduledParams) -> ScheduledMemory:
    """Return the memory with the pedometer's newest direction, and whether it turned."""
    if memory.walked_m == (0.0, 0.0):
        return memory
    heading_rad, before_rad = _direction_rad(memory.walked_m), memory.heading_rad
    memory = replace(memory, heading_rad=heading_rad)
    if before_rad is None or abs(wrap_angle(heading_rad - before_rad)) <= params.turn_rad:
        return memory
    return replace(memory, turned_s=time_s)


def _gathered(
    memory: ScheduledMemory, comparison: Comparison, params: ScheduledParams
) -> ScheduledMemory:
    """Return the memory with one more difference in the running mean, if it may count."""
    disagreement_rad = comparison.disagreement_rad
    if disagreement_rad is None:
        return memory
    if comparison.is_turning and abs(disagreement_rad) >= params.turn_offset_rad:
        return memory
    count = memory.offsets + 1
    offset_rad = wrap_angle(memory.offset_rad + disagreement_rad / count)
    return replace(memory, offset_rad=offset_rad, offsets=count)


def _direction_rad(vector: Vector) -> float:
    return math.atan2(vector[1], vector[0])
