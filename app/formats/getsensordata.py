"""Logs of the GetSensorData app (IPIN competitions) as survey walks.

Lines of ``;``-separated fields behind a four-letter word; times are seconds since the recording
began, and stay so: the log does not say when that was. ``POSI`` lines are where the surveyor was.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from app.core.motion.walks import survey_walks
from app.core.survey import Surveyed
from app.core.types import Reading, Truth
from app.formats.survey_ms2020 import MAX_SAMPLES, check_walk, trace_name
from app.formats.survey_places import (
    Reason,
    SurveyFrame,
    Unusable,
    UnusableError,
    number,
    surveyed_level,
)
from app.formats.trace_samples import TraceSamples
from app.formats.transmitters import eddystone_key, ibeacon_key, mac_key

SENSORS = {"ACCE": ("acc", 3), "GYRO": ("gyro", 3), "AHRS": ("rotation", 6)}
"""Name of a sensor's samples, and the field of their first component."""


@dataclass(slots=True)
class _Log:
    frame: SurveyFrame
    samples: TraceSamples = field(default_factory=TraceSamples)
    truths: list[Truth] = field(default_factory=list)
    lines: int = 0


def read_getsensordata(
    name: str, lines: Iterable[tuple[int, bytes]], frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the walks of a log, and what of it cannot be used."""
    log = _Log(frame)
    for line_number, raw in lines:
        line = raw.decode("utf-8", "replace")
        if line.startswith("%") or not line.strip():
            continue
        log.lines += 1
        try:
            _take(log, line)
        except UnusableError as error:
            yield Unusable(f"{name}:line {line_number}", error.reason, error.detail)
        except (ValueError, IndexError) as error:
            yield Unusable(f"{name}:line {line_number}", Reason.UNREADABLE, str(error))
    try:
        check_walk(log.samples, log.truths, log.lines)
        observations = [*log.samples.observations(), *log.truths]
    except UnusableError as error:
        yield Unusable(name, error.reason, error.detail)
    else:
        yield from survey_walks(trace_name(name), observations)


def _take(log: _Log, line: str) -> None:
    fields = line.split(";")
    kind = fields[0]
    if kind not in {*SENSORS, "WIFI", "BLE4", "POSI"} or log.lines > MAX_SAMPLES:
        return
    time_s = number(fields[1], "the time")
    if not 0.0 <= time_s < 1e10:
        raise UnusableError(Reason.NOT_A_TIME, fields[1])
    if kind in SENSORS:
        samples, first = SENSORS[kind]
        x, y, z = (number(fields[i], kind) for i in range(first, first + 3))
        log.samples.sensors.setdefault(samples, []).append((time_s, x, y, z))
    elif kind == "POSI":
        log.truths.append(_truth(log.frame, time_s, fields))
    else:
        keys, rssi_dbm = _wifi(fields) if kind == "WIFI" else _beacon(fields)
        time_ms = round(1000.0 * time_s)
        if kind == "WIFI":
            log.samples.take_wifi(time_ms, Reading(keys, rssi_dbm))
        else:
            log.samples.take_beacon(time_ms, keys, rssi_dbm)


def _truth(frame: SurveyFrame, time_s: float, fields: list[str]) -> Truth:
    lat_deg, lon_deg = number(fields[3], "the latitude"), number(fields[4], "the longitude")
    if lat_deg == lon_deg == 0.0:
        raise UnusableError(Reason.NO_WAYPOINT, "a POSI line of zeros")
    floor = frame.floor(_whole(fields[5]), fields[6] if len(fields) > 6 else "")
    x_m, y_m = frame.globe_place(floor, lat_deg, lon_deg)
    return Truth(time_s, x_m, y_m, floor.floor_id)


def _whole(text: str) -> str:
    return text.strip().removesuffix(".0")


def _wifi(fields: list[str]) -> tuple[tuple[str, ...], float]:
    # Network names may hold semicolons: count from the right. Older logs lack the frequency.
    has_frequency = ":" not in fields[-2]
    bssid = fields[-3] if has_frequency else fields[-2]
    return (mac_key(bssid),), surveyed_level(fields[-1])


def _beacon(fields: list[str]) -> tuple[tuple[str, ...], float]:
    mac, rssi_dbm = mac_key(fields[3]), surveyed_level(fields[4])
    if fields[2] == "iBeacon" and len(fields) >= 9:
        return (ibeacon_key(fields[8], int(fields[6]), int(fields[7])), mac), rssi_dbm
    if fields[2] == "Eddystone" and len(fields) >= 6 and len(fields[5]) == 32:
        return (eddystone_key(fields[5][:20], fields[5][20:]), mac), rssi_dbm
    return (mac,), rssi_dbm
