"""Traces of the Microsoft Indoor Location Competition 2.0: tab-separated sensor logs of one walk.

Each line is ``unix_ms TYPE_* values...``; lines that cannot be used are counted by reason, never
fatal. What comes out is what the phone's app would have posted: scans as they were reported, beacon
advertisements joined per second, inertial samples in blocks cut at whole seconds.
"""

import hashlib
import lzma
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from app.core.engine import order_key
from app.core.types import BleScan, FloatArray, ImuBlock, Observation, Reading, WifiScan

_SUFFIXES = (".txt.xz", ".txt")


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One recorded walk.

    Attributes
    ----------
    observations
        In the order of the fold.
    waypoints : (n, 3)
        Time (s), x and y (m) in the frame of the floor's own plan.
    skipped
        How many lines were passed over, by reason.
    """

    trace_id: str
    floor_name: str
    observations: tuple[Observation, ...]
    waypoints: FloatArray
    skipped: dict[str, int]


@dataclass(slots=True)
class _Lines:
    wifi: dict[int, dict[str, Reading]] = field(default_factory=dict)
    beacons: dict[int, list[tuple[int, tuple[str, ...], float]]] = field(default_factory=dict)
    sensors: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)
    waypoints: list[tuple[float, float, float]] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)


def trace_id_of(path: Path) -> str:
    """Return the trace's id: the file name without its suffixes."""
    return path.name.split(".", 1)[0]


def fold_of(trace_id: str) -> int:
    """Return the trace's fold, 0 to 3: from the md5 of its id, so that everybody splits alike."""
    return int(hashlib.md5(trace_id.encode(), usedforsecurity=False).hexdigest()[:8], 16) % 4


def trace_paths(folder: Path) -> list[Path]:
    """Return the trace files of a folder, by name."""
    return sorted(p for p in folder.iterdir() if p.name.endswith(_SUFFIXES))


def read_trace(path: Path) -> Trace:
    """Read one trace file, plain or xz.

    Raises
    ------
    ValueError
        If the file holds no line of a walk at all, or is not readable text.
    """
    try:
        raw = path.read_bytes()
        if path.suffix == ".xz":
            raw = lzma.decompress(raw)
    except (lzma.LZMAError, EOFError) as error:
        msg = f"{path.name}: not a complete xz file ({error})"
        raise ValueError(msg) from error
    return parse_trace(trace_id_of(path), path.parent.name, raw.decode("utf-8", "replace"))


def parse_trace(trace_id: str, floor_name: str, text: str) -> Trace:
    """Parse the text of one trace; see `read_trace`."""
    lines = _Lines()
    for line in text.splitlines():
        if line.startswith("#") or not line.strip():
            continue
        try:
            _take(lines, line.split("\t"))
        except (ValueError, IndexError):
            lines.skipped["unreadable"] += 1
    observations: list[Observation] = [
        *_wifi_scans(lines),
        *_ble_scans(lines),
        *_imu_blocks(lines),
    ]
    if not observations:
        msg = f"{trace_id}: no scan and no inertial sample in it"
        raise ValueError(msg)
    observations.sort(key=order_key)
    return Trace(
        trace_id,
        floor_name,
        tuple(observations),
        np.array(lines.waypoints, dtype=np.float64).reshape(-1, 3),
        dict(lines.skipped),
    )


def _take(lines: _Lines, fields: list[str]) -> None:
    time_ms, kind = int(fields[0]), fields[1]
    if kind in {"TYPE_ACCELEROMETER", "TYPE_GYROSCOPE", "TYPE_ROTATION_VECTOR"}:
        x, y, z = float(fields[2]), float(fields[3]), float(fields[4])
        lines.sensors.setdefault(kind, []).append((time_ms / 1000.0, x, y, z))
    elif kind == "TYPE_WIFI":
        _take_wifi(lines, time_ms, fields)
    elif kind == "TYPE_BEACON":
        _take_beacon(lines, time_ms, fields)
    elif kind == "TYPE_WAYPOINT":
        lines.waypoints.append((time_ms / 1000.0, float(fields[2]), float(fields[3])))
    else:
        lines.skipped[f"unused {kind}"] += 1


def _take_wifi(lines: _Lines, time_ms: int, fields: list[str]) -> None:
    # The network name comes first and may itself hold tabs: count from the right.
    bssid, rssi, last_seen_ms = fields[-4], fields[-3], fields[-1]
    key = f"mac:{_mac(bssid)}"
    reading = Reading((key,), float(rssi), max(time_ms - int(last_seen_ms), 0) / 1000.0)
    scan = lines.wifi.setdefault(time_ms, {})
    if key in scan and (scan[key].rssi_dbm, -scan[key].age_s) >= (
        reading.rssi_dbm,
        -reading.age_s,
    ):
        return
    scan[key] = reading


def _take_beacon(lines: _Lines, time_ms: int, fields: list[str]) -> None:
    uuid, major, minor, rssi = fields[2].lower(), int(fields[3]), int(fields[4]), fields[6]
    keys = [f"ibeacon:{_uuid(uuid)}:{major}:{minor}"]
    if len(fields) > 8:
        keys.append(f"mac:{_mac(fields[8])}")
    lines.beacons.setdefault(time_ms // 1000, []).append((time_ms, tuple(keys), float(rssi)))


def _mac(text: str) -> str:
    digits = "".join(c for c in text.lower() if c in "0123456789abcdef")
    if len(digits) != 12:
        msg = f"not a MAC: {text!r}"
        raise ValueError(msg)
    return digits


def _uuid(text: str) -> str:
    digits = text.replace("-", "")
    if len(digits) != 32:
        msg = f"not a UUID: {text!r}"
        raise ValueError(msg)
    return f"{digits[:8]}-{digits[8:12]}-{digits[12:16]}-{digits[16:20]}-{digits[20:]}"


def _wifi_scans(lines: _Lines) -> Iterable[WifiScan]:
    for time_ms, readings in lines.wifi.items():
        yield WifiScan(time_ms / 1000.0, tuple(readings.values()))


def _ble_scans(lines: _Lines) -> Iterable[BleScan]:
    for heard in lines.beacons.values():
        last_ms = max(time_ms for time_ms, _, _ in heard)
        yield BleScan(
            last_ms / 1000.0,
            tuple(Reading(keys, rssi, (last_ms - t_ms) / 1000.0) for t_ms, keys, rssi in heard),
        )


def _imu_blocks(lines: _Lines) -> Iterable[ImuBlock]:
    if "TYPE_ACCELEROMETER" not in lines.sensors:
        return
    acc = _by_time(lines.sensors["TYPE_ACCELEROMETER"])
    gyro = _by_time(lines.sensors.get("TYPE_GYROSCOPE", []))
    rotation = _by_time(lines.sensors.get("TYPE_ROTATION_VECTOR", []))
    second = np.floor(acc[:, 0])
    for k in np.unique(second):
        samples = acc[second == k]
        if len(samples) < 2:
            continue
        time_s = samples[:, 0]
        yield ImuBlock(
            time_s=float(time_s[0]),
            # The file's stamps are whole milliseconds: so is this rate to a thousandth.
            rate_hz=round((len(samples) - 1) / float(time_s[-1] - time_s[0]), 3),
            acc_mps2=samples[:, 1:].astype(np.float32),
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


def truth_at(waypoints: FloatArray, time_s: float) -> tuple[float, float] | None:
    """Return the place on the straight line between waypoints, None outside their time."""
    if not len(waypoints) or math.isnan(time_s):
        return None
    if time_s < waypoints[0, 0] or time_s > waypoints[-1, 0]:
        return None
    x = float(np.interp(time_s, waypoints[:, 0], waypoints[:, 1]))
    y = float(np.interp(time_s, waypoints[:, 0], waypoints[:, 2]))
    return x, y
