"""Traces of the Indoor Location Competition 2.0 as survey walks: scans, and where they were heard.

Reading a trace is work for one core; `survey_walk_or_reason` is what a pool of processes runs.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from app.core.types import BleScan, FloatArray, WifiScan
from app.formats.ms2020 import read_trace

Scan: TypeAlias = WifiScan | BleScan


@dataclass(frozen=True, slots=True, eq=False)
class SurveyWalk:
    """What a radio map takes from a trace.

    Attributes
    ----------
    waypoints : (n, 3)
        Time (s), x and y (m) in the frame of the floor's own plan.
    """

    trace_id: str
    floor_name: str
    scans: tuple[Scan, ...]
    waypoints: FloatArray


def read_survey_walk(path: Path) -> SurveyWalk:
    """Read a trace as a survey walk.

    Raises
    ------
    ValueError
        If it cannot be read, or has no waypoint or no Wi-Fi scan.
    """
    trace = read_trace(path)
    scans = tuple(o for o in trace.observations if isinstance(o, WifiScan | BleScan))
    if not any(isinstance(scan, WifiScan) for scan in scans):
        msg = "no Wi-Fi scan in it"
        raise ValueError(msg)
    if not len(trace.waypoints):
        msg = "no waypoint in it"
        raise ValueError(msg)
    return SurveyWalk(trace.trace_id, trace.floor_name, scans, trace.waypoints)


def survey_walk_or_reason(path: Path) -> SurveyWalk | str:
    """Return the walk of a trace, or in words why it cannot be used."""
    try:
        return read_survey_walk(path)
    except (ValueError, OSError) as error:
        return str(error)
