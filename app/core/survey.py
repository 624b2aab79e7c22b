"""What surveyors bring home, as stored: walks between waypoints, and scans at known points.

A walk is kept whole, so that a radio map can be built again by other rules of placing its scans.
Places are metres in the site's frame; headings are the phone's own, counter-clockwise from east.
"""

from dataclasses import dataclass
from typing import TypeAlias

from app.core.types import BleScan, FloatArray, WifiScan

Scan: TypeAlias = WifiScan | BleScan


@dataclass(frozen=True, slots=True, eq=False)
class SurveyWalk:
    """One uninterrupted walk on one floor.

    Attributes
    ----------
    scans
        In the order of the fold.
    strides : (n, 3)
        Time (s), length (m) and heading (rad, from east as the phone believed; nan if unknown) of
        each step, in time order; empty for a phone without inertial sensors.
    waypoints : (m, 3)
        Time (s), x and y (m, site frame) where the surveyor said to be, in time order; never empty.
    """

    walk: str
    floor_id: str
    scans: tuple[Scan, ...]
    strides: FloatArray
    waypoints: FloatArray

    @property
    def span_s(self) -> tuple[float, float]:
        """Return the times of the first and the last scan or waypoint."""
        times = [scan.time_s for scan in self.scans] + self.waypoints[:, 0].tolist()
        return min(times), max(times)


@dataclass(frozen=True, slots=True)
class SurveyPoint:
    """Levels heard at one known place: a fingerprint as it was surveyed.

    Attributes
    ----------
    walk
        What it was surveyed along with: validation leaves out all of a walk at once.
    time_s
        When, if that was told.
    """

    point: str
    floor_id: str
    x_m: float
    y_m: float
    wifi_dbm: dict[str, float]
    ble_dbm: dict[str, float]
    walk: str = ""
    time_s: float | None = None


Surveyed: TypeAlias = SurveyWalk | SurveyPoint
