"""Traces of the Microsoft Indoor Location Competition 2.0: tab-separated sensor logs of one walk.

Each line is ``unix_ms TYPE_* values...``; lines that cannot be used are counted by reason, never
fatal. What comes out is what the phone's app would have posted: scans as they were reported, beacon
advertisements joined per second, inertial samples in blocks cut at whole seconds.
"""

import hashlib
import lzma
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.core.types import FloatArray, Observation, Reading
from app.formats.trace_samples import TraceSamples, level
from app.formats.transmitters import ibeacon_key, mac_key

_SUFFIXES = (".txt.xz", ".txt")
TRACES_FOLDER = "path_data_files"
"""Where the competition's own repository keeps a floor's traces."""
SENSORS = {
    "TYPE_ACCELEROMETER": "acc",
    "TYPE_GYROSCOPE": "gyro",
    "TYPE_ROTATION_VECTOR": "rotation",
}


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


def trace_id_of(path: Path) -> str:
    """Return the trace's id: the file name without its suffixes."""
    return path.name.split(".", 1)[0]


def fold_of(trace_id: str) -> int:
    """Return the trace's fold, 0 to 3: from the md5 of its id, so that everybody splits alike."""
    return int(hashlib.md5(trace_id.encode(), usedforsecurity=False).hexdigest()[:8], 16) % 4


def trace_paths(folder: Path) -> list[Path]:
    """Return the trace files of a floor's folder, or in its folder of traces, by name."""
    inside = [folder, *(p for p in (folder / TRACES_FOLDER,) if p.is_dir())]
    paths = (p for each in inside for p in each.iterdir() if p.name.endswith(_SUFFIXES))
    return sorted(paths, key=lambda p: p.name)


def floor_folder_of(path: Path) -> Path:
    """Return the floor's folder that a trace is in; its name is the floor's."""
    return path.parent.parent if path.parent.name == TRACES_FOLDER else path.parent


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
    return parse_trace(
        trace_id_of(path), floor_folder_of(path).name, raw.decode("utf-8", "replace")
    )


def parse_trace(trace_id: str, floor_name: str, text: str) -> Trace:
    """Parse the text of one trace; see `read_trace`."""
    samples, skipped = TraceSamples(), Counter[str]()
    for line in text.splitlines():
        if line.startswith("#") or not line.strip():
            continue
        try:
            if not take_line(samples, line):
                skipped[f"unused {line.split(chr(9))[1]}"] += 1
        except (ValueError, IndexError, OverflowError):
            skipped["unreadable"] += 1
    observations = samples.observations()
    if not observations:
        msg = f"{trace_id}: no scan and no inertial sample in it"
        raise ValueError(msg)
    waypoints = np.array(samples.waypoints, dtype=np.float64).reshape(-1, 3)
    return Trace(trace_id, floor_name, observations, waypoints, dict(skipped))


def take_line(samples: TraceSamples, line: str) -> bool:
    """Add what a line says to the samples; tell whether it is of a kind that is used.

    Raises
    ------
    ValueError, IndexError, OverflowError
        If the line cannot be read.
    """
    fields = line.split("\t")
    time_ms, kind = int(fields[0]), fields[1]
    if kind in SENSORS:
        x, y, z = float(fields[2]), float(fields[3]), float(fields[4])
        samples.sensors.setdefault(SENSORS[kind], []).append((time_ms / 1000.0, x, y, z))
    elif kind == "TYPE_WIFI":
        # The network name comes first and may itself hold tabs: count from the right.
        age_s = max(time_ms - int(fields[-1]), 0) / 1000.0
        samples.take_wifi(time_ms, Reading((mac_key(fields[-4]),), level(fields[-3]), age_s))
    elif kind == "TYPE_BEACON":
        _take_beacon(samples, time_ms, fields)
    elif kind == "TYPE_WAYPOINT":
        samples.waypoints.append((time_ms / 1000.0, float(fields[2]), float(fields[3])))
    else:
        return False
    return True


def _take_beacon(samples: TraceSamples, time_ms: int, fields: list[str]) -> None:
    keys = [ibeacon_key(fields[2], int(fields[3]), int(fields[4]))]
    if len(fields) > 8:
        keys.append(mac_key(fields[8]))
    samples.take_beacon(time_ms, tuple(keys), level(fields[6]))


def truth_at(waypoints: FloatArray, time_s: float) -> tuple[float, float] | None:
    """Return the place on the straight line between waypoints, None outside their time."""
    if not len(waypoints) or math.isnan(time_s):
        return None
    if time_s < waypoints[0, 0] or time_s > waypoints[-1, 0]:
        return None
    x = float(np.interp(time_s, waypoints[:, 0], waypoints[:, 1]))
    y = float(np.interp(time_s, waypoints[:, 0], waypoints[:, 2]))
    return x, y
