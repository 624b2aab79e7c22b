"""Samples of one recorded walk as they are read line by line, and the observations they make.

What comes out is what the phone's app would have posted: scans as they were reported, beacon
advertisements joined per second, inertial samples in blocks cut at whole seconds.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from app.core.engine import order_key
from app.core.types import BleScan, FloatArray, ImuBlock, Observation, Reading, WifiScan

# Levels that no receiver reports: noise is louder than the one, no phone stands the other.
_WEAKEST_DBM, _STRONGEST_DBM = -200.0, 50.0


def level(text: str) -> float:
    """Return a received level; ValueError if it is none."""
    rssi_dbm = float(text)
    if not _WEAKEST_DBM <= rssi_dbm <= _STRONGEST_DBM:
        msg = f"not a level in dBm: {text!r}"
        raise ValueError(msg)
    return rssi_dbm


@dataclass(slots=True)
class TraceSamples:
    """What was read of a walk so far.

    Attributes
    ----------
    wifi
        Readings by report (ms) and transmitter.
    beacons
        Advertisements by whole second.
    sensors
        Rows of time (s), x, y, z of ``acc``, ``gyro`` and ``rotation``.
    waypoints
        Time (s), x, y (m).
    """

    wifi: dict[int, dict[str, Reading]] = field(default_factory=dict)
    beacons: dict[int, list[tuple[int, tuple[str, ...], float]]] = field(default_factory=dict)
    sensors: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    waypoints: list[tuple[float, float, float]] = field(default_factory=list)

    def take_wifi(self, time_ms: int, reading: Reading) -> None:
        """Add an access point to the report of ``time_ms``; the strongest, then newest, stays."""
        scan = self.wifi.setdefault(time_ms, {})
        known = scan.get(reading.keys[0])
        if known is None or (known.rssi_dbm, -known.age_s) < (reading.rssi_dbm, -reading.age_s):
            scan[reading.keys[0]] = reading

    def take_beacon(self, time_ms: int, keys: tuple[str, ...], rssi_dbm: float) -> None:
        """Add an advertisement."""
        self.beacons.setdefault(time_ms // 1000, []).append((time_ms, keys, rssi_dbm))

    def observations(self) -> tuple[Observation, ...]:
        """Return all of it in the order of the fold."""
        observations: list[Observation] = [
            *_wifi_scans(self),
            *_ble_scans(self),
            *_imu_blocks(self),
        ]
        return tuple(sorted(observations, key=order_key))


def _wifi_scans(samples: TraceSamples) -> Iterable[WifiScan]:
    for time_ms, readings in samples.wifi.items():
        yield WifiScan(time_ms / 1000.0, tuple(readings.values()))


def _ble_scans(samples: TraceSamples) -> Iterable[BleScan]:
    for heard in samples.beacons.values():
        last_ms = max(time_ms for time_ms, _, _ in heard)
        yield BleScan(
            last_ms / 1000.0,
            tuple(Reading(keys, rssi, (last_ms - t_ms) / 1000.0) for t_ms, keys, rssi in heard),
        )


def _imu_blocks(samples: TraceSamples) -> Iterable[ImuBlock]:
    if "acc" not in samples.sensors:
        return
    acc = _by_time(samples.sensors["acc"])
    gyro = _by_time(samples.sensors.get("gyro", []))
    rotation = _by_time(samples.sensors.get("rotation", []))
    second = np.floor(acc[:, 0])
    for k in np.unique(second):
        block = acc[second == k]
        if len(block) < 2:
            continue
        time_s = block[:, 0]
        yield ImuBlock(
            time_s=float(time_s[0]),
            # The file's stamps are whole milliseconds: so is this rate to a thousandth.
            rate_hz=round((len(block) - 1) / float(time_s[-1] - time_s[0]), 3),
            acc_mps2=block[:, 1:].astype(np.float32),
            gyro_radps=_nearest(gyro, time_s)[:, 1:].astype(np.float32),
            mag_ut=np.empty((0, 3), dtype=np.float32),
            quat_wxyz=_quaternions(_nearest(rotation, time_s)[:, 1:]),
        )


def _by_time(rows: list[tuple[float, ...]]) -> FloatArray:
    samples = np.array(rows, dtype=np.float64).reshape(-1, 4)
    _, first = np.unique(samples[:, 0], return_index=True)
    return samples[first]


def _nearest(samples: FloatArray, time_s: FloatArray) -> FloatArray:
    if not len(samples):
        return samples
    after = np.clip(np.searchsorted(samples[:, 0], time_s), 1, max(len(samples) - 1, 1))
    after = np.minimum(after, len(samples) - 1)
    before = np.maximum(after - 1, 0)
    closer = time_s - samples[before, 0] <= samples[after, 0] - time_s
    return samples[np.where(closer, before, after)]


def _quaternions(rotation_xyz: FloatArray) -> npt.NDArray[np.float32]:
    w = np.sqrt(np.maximum(0.0, 1.0 - np.sum(rotation_xyz**2, axis=1, keepdims=True)))
    return np.hstack([w, rotation_xyz]).astype(np.float32)
