"""The values that travel through the engine: observations in, track points or their absence out.

Frames: metres in the site's one metric frame (x right, y up on the plan). Angles are radians
counter-clockwise: what a phone reports from east (`Steps`, `ImuBlock`), what is told of it from the
plan's +x (`TrackPoint`). `SiteModel.x_axis_from_east_rad` lies between the two; a site that is not
on the globe has its plan north up, and both are the same. Times are seconds since the Unix epoch as
floats (event time: the phone's clock after the session's frozen offset).
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]


class MotionMode(StrEnum):
    """What the phone's carrier is doing."""

    STILL = "still"
    WALKING = "walking"


class Method(StrEnum):
    """How the position of a fix or track point came about."""

    LATERATION = "lateration"
    FINGERPRINT = "fingerprint"
    DEAD_RECKONING = "dead_reckoning"
    FUSED = "fused"


class NoFixReason(StrEnum):
    """Why there is no position; stable codes, shown to users."""

    NOTHING_HEARD = "nothing_heard"
    TOO_FEW_TRANSMITTERS = "too_few_transmitters"
    UNKNOWN_TRANSMITTERS = "unknown_transmitters"
    READINGS_TOO_OLD = "readings_too_old"
    DEGENERATE_GEOMETRY = "degenerate_geometry"
    OUTSIDE_MAPPED_AREA = "outside_mapped_area"
    NO_RADIO_MAP_OR_BEACONS = "no_radio_map_or_beacons"
    NO_BEACONS = "no_beacons"
    NOT_STARTED = "not_started"


@dataclass(frozen=True, slots=True)
class Reading:
    """One transmitter heard once.

    Attributes
    ----------
    keys
        Canonical transmitter keys, most specific first: ``mac:<12 hex>``,
        ``ibeacon:<uuid>:<major>:<minor>``, ``eddystone:<namespace>:<instance>``,
        ``altbeacon:<40 hex>``.
        A phone may know one transmitter by several (Android: MAC and iBeacon, iOS: iBeacon only).
    rssi_dbm
        Received level.
    age_s
        How long before the scan's ``time_s`` the level was measured.
    """

    keys: tuple[str, ...]
    rssi_dbm: float
    age_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WifiScan:
    """One report of the phone's Wi-Fi scanner."""

    time_s: float
    readings: tuple[Reading, ...]


@dataclass(frozen=True, slots=True)
class BleScan:
    """Advertisements heard since the last report."""

    time_s: float
    readings: tuple[Reading, ...]


@dataclass(frozen=True, slots=True)
class BeaconTelemetry:
    """What a beacon tells of itself, such as an Eddystone-TLM frame; no estimator sees it.

    ``keys`` are as of a `Reading`. None: it did not tell.
    """

    keys: tuple[str, ...]
    battery_percent: float | None = None
    battery_v: float | None = None
    temperature_degc: float | None = None


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps told by the phone's own detector.

    ``heading_rad`` is the walking direction as the phone believes it, if it does: radians
    counter-clockwise from east, whatever the plan's rotation.
    """

    time_s: float
    count: int
    step_length_m: float | None = None
    heading_rad: float | None = None
    heading_sigma_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Pedometer:
    """A pedometer interval (iOS): steps and distance between ``begin_s`` and ``time_s``.

    It is folded at its end: no phone can tell it earlier.
    """

    begin_s: float
    time_s: float
    steps: int
    distance_m: float | None = None
    floors_up: int = 0
    floors_down: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class ImuBlock:
    """Evenly sampled inertial data; sample i was taken at ``time_s + i / rate_hz``.

    A block is folded at its first sample's time; steps found in it wait in the session's state
    until their own time comes, so a scan in the middle of a block never sees the future.

    Attributes
    ----------
    acc_mps2 : (n, 3)
        Specific force in the phone's Android axes; at rest face-up z is +9.81.
    gyro_radps : (n, 3) or (0, 3)
        Angular rate.
    mag_ut : (n, 3) or (0, 3)
        Magnetic field, microtesla.
    quat_wxyz : (n, 4) or (0, 4)
        Rotation vector as a unit quaternion, phone frame to east-north-up.
    """

    time_s: float
    rate_hz: float
    acc_mps2: npt.NDArray[np.float32]
    gyro_radps: npt.NDArray[np.float32]
    mag_ut: npt.NDArray[np.float32]
    quat_wxyz: npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Barometer:
    """Air pressure."""

    time_s: float
    pressure_hpa: float


@dataclass(frozen=True, slots=True)
class Truth:
    """A surveyor's statement of where the phone is; for surveys, never seen by an estimator."""

    time_s: float
    x_m: float
    y_m: float
    floor_id: str
    note: str = ""


Observation: TypeAlias = WifiScan | BleScan | Steps | Pedometer | ImuBlock | Barometer | Truth


@dataclass(frozen=True, slots=True)
class Anchor:
    """A transmitter with a surveyed position and its calibration, as the estimators see it.

    Level model: ``rssi = ref_level_dbm - 10 path_loss_exponent log10(d / ref_distance_m)`` with
    normal deviation ``shadowing_db``.
    """

    anchor_id: str
    keys: tuple[str, ...]
    floor_id: str
    x_m: float
    y_m: float
    z_m: float = 0.0
    ref_level_dbm: float = -59.0
    ref_distance_m: float = 1.0
    path_loss_exponent: float = 2.0
    shadowing_db: float = 5.0


@dataclass(frozen=True, slots=True)
class Used:
    """What a point rests on: transmitters of the newest scan, and the steps walked since."""

    beacons: int = 0
    access_points: int = 0
    steps: int = 0


@dataclass(frozen=True, slots=True)
class TrackPoint:
    """Filtered position at one instant.

    Attributes
    ----------
    covariance_m2
        ``(xx, xy, yy)`` of the horizontal position.
    radius95_m
        Radius of the circle that is predicted to hold the true position in 95 of 100 cases.
    heading_rad
        Direction of walking, counter-clockwise from the plan's +x; None while unknown.
    age_s
        Time since the newest observation that told the position (not only that time passed);
        before the first, in a smoothed track, until that.
    """

    time_s: float
    floor_id: str
    x_m: float
    y_m: float
    covariance_m2: tuple[float, float, float]
    radius95_m: float
    speed_mps: float
    heading_rad: float | None
    motion: MotionMode
    method: Method
    floor_confidence: float
    used: Used
    age_s: float
    profile: str = "best"
    zones: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NoFix:
    """The expected absence of a position at ``time_s``, with its reason."""

    time_s: float
    reason: NoFixReason


Output: TypeAlias = TrackPoint | NoFix


@dataclass(frozen=True, slots=True)
class Candidate:
    """One place where the phone may be, with the weight a matcher gives it."""

    floor_index: int
    x_m: float
    y_m: float
    weight: float


@dataclass(frozen=True, slots=True)
class Fix:
    """Unfiltered position of one epoch.

    ``covariance_m2`` is ``(xx, xy, yy)``; ``velocity_mps`` is set by the kinematic model only.
    """

    time_s: float
    x_m: float
    y_m: float
    covariance_m2: tuple[float, float, float]
    method: Method
    used: Used = field(default_factory=Used)
    velocity_mps: tuple[float, float] | None = None
