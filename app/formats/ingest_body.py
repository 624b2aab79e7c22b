"""Core observations as the JSON body that a phone posts to ``/v1/ingest``.

The inverse of what the API decodes: a test holds that observations come back as they were. Times
are told in milliseconds to the microsecond; inertial samples in the shortest digits that give the
same 32-bit number again.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

from app.core.types import (
    Barometer,
    BleScan,
    ImuBlock,
    Observation,
    Pedometer,
    Reading,
    Steps,
    Truth,
    WifiScan,
)

Record: TypeAlias = dict[str, Any]


def record_of(observation: Observation) -> Record:
    """Return the ingest record of an observation in wall-clock time; ``None`` fields left out."""
    record = _record(observation)
    return {name: value for name, value in record.items() if value is not None}


def ingest_body(header: Mapping[str, Any], seq: int, observations: Iterable[Observation]) -> bytes:
    """Return the JSON body of one batch.

    Parameters
    ----------
    header
        The fields that all batches of a session share: ``device``, ``session``, ``clock``,
        and ``site`` where the token does not say it.
    """
    return msgspec.json.encode({**header, "seq": seq, "records": [*map(record_of, observations)]})


def _record(observation: Observation) -> Record:  # noqa: PLR0911 - one return per kind
    match observation:
        case WifiScan():
            return {"k": "wifi", **_instant(observation), "aps": _access_points(observation)}
        case BleScan():
            beacons = [_beacon(reading) for reading in observation.readings]
            return {"k": "ble", **_instant(observation), "beacons": beacons}
        case Steps():
            return _steps(observation)
        case Pedometer():
            return _pedometer(observation)
        case ImuBlock():
            return _imu(observation)
        case Barometer():
            return {"k": "baro", **_instant(observation), "hpa": observation.pressure_hpa}
        case Truth():
            place = {"x": observation.x_m, "y": observation.y_m, "floor_id": observation.floor_id}
            return {"k": "truth", **_instant(observation), **place, "note": observation.note}


def _ms(time_s: float) -> float:
    return round(time_s * 1000.0, 3)


def _instant(observation: Observation) -> Record:
    return {"t_ms": _ms(observation.time_s)}


def _access_points(scan: WifiScan) -> list[Record]:
    return [
        {
            "bssid": reading.keys[0].removeprefix("mac:"),
            "rssi": reading.rssi_dbm,
            "age_ms": _ms(reading.age_s),
        }
        for reading in scan.readings
    ]


def _beacon(reading: Reading) -> Record:
    beacon: Record = {"rssi": reading.rssi_dbm, "age_ms": _ms(reading.age_s)}
    for key in reading.keys:
        kind, *parts = key.split(":")
        if kind == "ibeacon":
            uuid, major, minor = parts
            beacon[kind] = {"uuid": uuid, "major": int(major), "minor": int(minor)}
        elif kind == "eddystone":
            beacon[kind] = {"namespace": parts[0], "instance": parts[1]}
        elif kind == "altbeacon":
            beacon[kind] = {"id": parts[0]}
        else:
            beacon[kind] = parts[0]
    return beacon


def _steps(steps: Steps) -> Record:
    sigma_rad = steps.heading_sigma_rad
    return {
        "k": "step",
        **_instant(steps),
        "n": steps.count,
        "len_m": steps.step_length_m,
        "heading_deg": None if steps.heading_rad is None else _heading_deg(steps.heading_rad),
        "heading_std_deg": None if sigma_rad is None else math.degrees(sigma_rad),
    }


def _heading_deg(heading_rad: float) -> float:
    """Return clockwise-from-north degrees (0..360) of counter-clockwise-from-east radians."""
    return (90.0 - math.degrees(heading_rad)) % 360.0


def _pedometer(interval: Pedometer) -> Record:
    return {
        "k": "pedometer",
        "t0_ms": _ms(interval.begin_s),
        "t1_ms": _ms(interval.time_s),
        "steps": interval.steps,
        "dist_m": interval.distance_m,
        "floors_up": interval.floors_up,
        "floors_down": interval.floors_down,
    }


def _imu(block: ImuBlock) -> Record:
    return {
        "k": "imu",
        "t0_ms": _ms(block.time_s),
        "rate_hz": block.rate_hz,
        "acc": _samples(block.acc_mps2),
        "gyro": _samples(block.gyro_radps),
        "mag": _samples(block.mag_ut),
        "quat": _samples(block.quat_wxyz),
    }


def _samples(samples: npt.NDArray[np.float32]) -> list[list[float]]:
    # The text of a float32 is the shortest that reads as it; a plain conversion has 17 digits.
    shortest: list[list[float]] = samples.astype(np.str_).astype(np.float64).tolist()
    return shortest
