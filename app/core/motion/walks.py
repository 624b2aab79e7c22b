"""Walks of a survey from what a phone reported and where its surveyor said to be.

A walk is on one floor: where the surveyor's next statement is on another one, a new walk begins.
Scans between the two floors belong to neither, nobody knows where they were made.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from app.core.motion.steps import StepDetector, detect_steps, step_length_m
from app.core.params import StepParams
from app.core.survey import SurveyWalk
from app.core.types import (
    BleScan,
    FloatArray,
    ImuBlock,
    Observation,
    Pedometer,
    Steps,
    Truth,
    WifiScan,
)

LEAD_S, TRAIL_S = 10.0, 10.0
"""Scans and strides this long before the first and after the last waypoint are kept: a scan tells
what was heard over some seconds, and a smoother gains from how the walk began."""


def survey_walks(name: str, observations: Sequence[Observation]) -> list[SurveyWalk]:
    """Return the walks of a recording, one for each run of `Truth` on one floor.

    Parameters
    ----------
    name
        Of the walk; further ones get ``/2``, ``/3``...
    observations
        In the order of the fold, `Truth` among them.
    """
    truths = sorted((o for o in observations if isinstance(o, Truth)), key=lambda o: o.time_s)
    runs = [list(run) for _, run in groupby(truths, key=lambda truth: truth.floor_id)]
    scans = [o for o in observations if isinstance(o, WifiScan | BleScan)]
    strides = strides_of(observations, StepParams())
    walks = []
    for i, run in enumerate(runs):
        begin_s = max(run[0].time_s - LEAD_S, runs[i - 1][-1].time_s if i else -math.inf)
        last = i + 1 == len(runs)
        end_s = min(run[-1].time_s + TRAIL_S, math.inf if last else runs[i + 1][0].time_s)
        walks.append(
            SurveyWalk(
                walk=name if i == 0 else f"{name}/{i + 1}",
                floor_id=run[0].floor_id,
                scans=tuple(scan for scan in scans if begin_s <= scan.time_s <= end_s),
                strides=strides[(strides[:, 0] >= begin_s) & (strides[:, 0] <= end_s)],
                waypoints=np.array([(t.time_s, t.x_m, t.y_m) for t in run], dtype=np.float64),
            )
        )
    return walks


def strides_of(observations: Sequence[Observation], params: StepParams) -> FloatArray:
    """Return the strides (n, 3) of a recording: time (s), length (m), heading (rad, from east).

    The phone's own steps if it told any, else those found in its acceleration; a phone that tells
    no direction lends its steps the one its inertial sensors had. nan: no direction known.
    """
    detector = StepDetector()
    found: list[tuple[float, float, float]] = []
    told: list[tuple[float, float, float]] = []
    for observation in observations:
        if isinstance(observation, ImuBlock):
            detector, steps = detect_steps(detector, observation, params)
            found += [(s.time_s, step_length_m(s, params), s.heading_rad) for s in steps]
        elif isinstance(observation, Steps):
            told += _told(observation, detector.heading_rad, params)
        elif isinstance(observation, Pedometer):
            told += _spread(observation, detector.heading_rad, params)
    strides = np.array(told or found, dtype=np.float64).reshape(-1, 3)
    usable = np.isfinite(strides[:, :2]).all(axis=1)
    return np.asarray(strides[usable][np.argsort(strides[usable, 0], kind="stable")])


def _told(
    steps: Steps, heading_rad: float, params: StepParams
) -> Iterator[tuple[float, float, float]]:
    length_m = params.usual_length_m if steps.step_length_m is None else steps.step_length_m
    heading_rad = heading_rad if steps.heading_rad is None else steps.heading_rad
    seconds = 1.0 / params.cadence_hz
    for i in reversed(range(steps.count)):
        yield steps.time_s - seconds * i, length_m, heading_rad


def _spread(
    interval: Pedometer, heading_rad: float, params: StepParams
) -> Iterator[tuple[float, float, float]]:
    if not interval.steps:
        return
    seconds = (interval.time_s - interval.begin_s) / interval.steps
    length_m = params.usual_length_m
    if interval.distance_m is not None:
        length_m = interval.distance_m / interval.steps
    for i in reversed(range(interval.steps)):
        yield interval.time_s - seconds * i, length_m, heading_rad
