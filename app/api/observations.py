"""Records to core observations: canonical transmitter keys, core units, the phone's own time."""

import math
from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from app.api.ingest_schema import (
    BaroRecord,
    BleRecord,
    HeardBeacon,
    ImuRecord,
    PedometerRecord,
    Record,
    StepRecord,
    Telemetry,
    Timed,
    TruthRecord,
    WifiRecord,
)
from app.core.geometry import wrap_angle
from app.core.types import (
    Barometer,
    BeaconTelemetry,
    BleScan,
    FloatArray,
    ImuBlock,
    Pedometer,
    Reading,
    Steps,
    Truth,
    WifiScan,
)
from app.formats.eddystone_tlm import NO_TEMPERATURE_DEGC, tlm_telemetry
from app.formats.transmitters import altbeacon_key, eddystone_key, ibeacon_key, mac_key
from app.sessions.batch import IncomingRecord

# Android hides the real address behind these when the app lacks a permission.
_PLACEHOLDERS = frozenset({"mac:020000000000", "mac:000000000000"})

# No phone sensor reaches these; a wrong unit (g, deg/s, nT) or a broken driver does.
_MAX_ACC_MPS2 = 400.0
_MAX_GYRO_RADPS = 100.0
_MAX_MAG_UT = 10_000.0
_QUAT_NORM_TOLERANCE = 0.1


class RecordCode(StrEnum):
    """Stable codes of rejected records; part of the API's contract (docs/api.md lists them)."""

    WRONG_TYPE = "wrong_type"
    MISSING_FIELD = "missing_field"
    OUT_OF_RANGE = "out_of_range"
    TOO_LONG = "too_long"
    WRONG_FORMAT = "wrong_format"
    LENGTH_MISMATCH = "length_mismatch"
    TIME_MISSING = "time_missing"
    TIME_ORDER = "time_order"
    NO_CLOCK = "no_clock"
    TOO_OLD = "too_old"
    IN_FUTURE = "in_future"
    ROLE_FORBIDDEN = "role_forbidden"


class Refusal(Exception):  # noqa: N818 - a verdict about one record, not a failure
    """Why a record is not taken: stable code, JSON pointer inside the record, words."""

    def __init__(self, code: RecordCode, pointer: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code
        self.pointer = pointer


def observation_of(index: int, record: Record) -> IncomingRecord:
    """Return the observation of a record, in core units and the phone's own time.

    Raises
    ------
    Refusal
        If the record cannot be meant.
    """
    return _BUILDERS[type(record)](index, record)


def _instant(record: Timed) -> tuple[float, bool]:
    if record.mono_ms is not None:
        return record.mono_ms / 1000.0, True
    if record.t_ms is not None:
        return record.t_ms / 1000.0, False
    raise Refusal(RecordCode.TIME_MISSING, "", "one of t_ms and mono_ms is needed")


def _wifi(index: int, record: WifiRecord) -> IncomingRecord:
    time_s, monotonic = _instant(record)
    strongest: dict[str, Reading] = {}
    for i, heard in enumerate(record.aps):
        key = _mac_key(heard.bssid, f"/aps/{i}/bssid")
        if key is None or _is_absent(heard.rssi):
            continue
        reading = Reading((key,), heard.rssi, heard.age_ms / 1000.0)
        known = strongest.get(key)
        if known is None or _strength(reading) > _strength(known):
            strongest[key] = reading
    return IncomingRecord(index, WifiScan(time_s, tuple(strongest.values())), monotonic)


def _ble(index: int, record: BleRecord) -> IncomingRecord:
    time_s, monotonic = _instant(record)
    readings: dict[Reading, None] = {}
    telemetry: list[BeaconTelemetry] = []
    for i, heard in enumerate(record.beacons):
        keys = tuple(_beacon_keys(heard, f"/beacons/{i}"))
        telemetry += _telemetry(keys, heard, f"/beacons/{i}")
        if keys and not _is_absent(heard.rssi):
            readings[Reading(keys, heard.rssi, heard.age_ms / 1000.0)] = None
    scan = BleScan(time_s, tuple(readings))
    return IncomingRecord(index, scan, monotonic, tuple(telemetry))


def _telemetry(
    keys: tuple[str, ...], heard: HeardBeacon, pointer: str
) -> Iterator[BeaconTelemetry]:
    """Yield what a beacon told of itself: by its frame, and as the app has read it."""
    if isinstance(heard.tlm, str):
        try:
            frame = tlm_telemetry(keys, heard.tlm)
        except ValueError as error:
            raise Refusal(RecordCode.WRONG_FORMAT, f"{pointer}/tlm", str(error)) from error
        if frame is not None:
            yield frame
    if isinstance(heard.telemetry, Telemetry):
        told = heard.telemetry
        yield BeaconTelemetry(
            keys,
            told.battery_percent,
            told.battery_mv / 1000.0 if told.battery_mv else None,
            None if told.temperature_c == NO_TEMPERATURE_DEGC else told.temperature_c,
        )


def _step(index: int, record: StepRecord) -> IncomingRecord:
    time_s, monotonic = _instant(record)
    heading_sigma = record.heading_std_deg
    steps = Steps(
        time_s,
        record.n,
        record.len_m,
        None if record.heading_deg is None else heading_rad_of(record.heading_deg),
        None if heading_sigma is None else math.radians(heading_sigma),
    )
    return IncomingRecord(index, steps, monotonic)


def _pedometer(index: int, record: PedometerRecord) -> IncomingRecord:
    monotonic = record.mono0_ms is not None and record.mono1_ms is not None
    begin_ms = record.mono0_ms if monotonic else record.t0_ms
    end_ms = record.mono1_ms if monotonic else record.t1_ms
    if begin_ms is None or end_ms is None:
        raise Refusal(
            RecordCode.TIME_MISSING, "", "t0_ms and t1_ms, or mono0_ms and mono1_ms, are needed"
        )
    if end_ms < begin_ms:
        raise Refusal(RecordCode.TIME_ORDER, "", "the interval ends before it begins")
    interval = Pedometer(
        begin_ms / 1000.0,
        end_ms / 1000.0,
        record.steps,
        record.dist_m,
        record.floors_up or 0,
        record.floors_down or 0,
    )
    return IncomingRecord(index, interval, monotonic)


def _imu(index: int, record: ImuRecord) -> IncomingRecord:
    mono_ms = record.mono0_ms if record.mono0_ms is not None else record.mono_ms
    begin_ms = mono_ms if mono_ms is not None else record.t0_ms
    if begin_ms is None:
        raise Refusal(RecordCode.TIME_MISSING, "", "one of t0_ms and mono0_ms is needed")
    count = len(record.acc)
    quat_wxyz = _samples(record.quat, 4, count, "quat")
    norms = np.linalg.norm(quat_wxyz, axis=1)
    _refuse_first(np.abs(norms - 1.0) > _QUAT_NORM_TOLERANCE, "quat", "is not a unit quaternion")
    block = ImuBlock(
        begin_ms / 1000.0,
        record.rate_hz,
        _bounded(_samples(record.acc, 3, count, "acc"), _MAX_ACC_MPS2, "acc"),
        _bounded(_samples(record.gyro, 3, count, "gyro"), _MAX_GYRO_RADPS, "gyro"),
        _bounded(_samples(record.mag, 3, count, "mag"), _MAX_MAG_UT, "mag"),
        quat_wxyz.astype(np.float32),
    )
    return IncomingRecord(index, block, mono_ms is not None)


def _baro(index: int, record: BaroRecord) -> IncomingRecord:
    time_s, monotonic = _instant(record)
    return IncomingRecord(index, Barometer(time_s, record.hpa), monotonic)


def _truth(index: int, record: TruthRecord) -> IncomingRecord:
    time_s, monotonic = _instant(record)
    truth = Truth(time_s, record.x, record.y, record.floor_id, record.note)
    return IncomingRecord(index, truth, monotonic)


_BUILDERS: dict[type, Callable[[int, Any], IncomingRecord]] = {
    WifiRecord: _wifi,
    BleRecord: _ble,
    StepRecord: _step,
    PedometerRecord: _pedometer,
    ImuRecord: _imu,
    BaroRecord: _baro,
    TruthRecord: _truth,
}


def heading_rad_of(heading_deg: float) -> float:
    """Return clockwise-from-north degrees as counter-clockwise-from-east radians."""
    return float(wrap_angle(math.pi / 2.0 - math.radians(heading_deg)))


def _is_absent(rssi_dbm: float) -> bool:
    return rssi_dbm == 0 or rssi_dbm >= 20 or rssi_dbm <= -127


def _strength(reading: Reading) -> tuple[float, float]:
    return (reading.rssi_dbm, -reading.age_s)


def _mac_key(mac: str, pointer: str) -> str | None:
    key = _spelled(pointer, mac_key, mac)
    return None if key in _PLACEHOLDERS else key


def _beacon_keys(heard: HeardBeacon, pointer: str) -> Iterable[str]:
    if not any((heard.ibeacon, heard.eddystone, heard.altbeacon, heard.mac)):
        raise Refusal(
            RecordCode.MISSING_FIELD, pointer, "one of ibeacon, eddystone, altbeacon, mac is needed"
        )
    if (frame := heard.ibeacon) is not None:
        yield _spelled(f"{pointer}/ibeacon", ibeacon_key, frame.uuid, frame.major, frame.minor)
    if (uid := heard.eddystone) is not None:
        yield _spelled(f"{pointer}/eddystone", eddystone_key, uid.namespace, uid.instance)
    if heard.altbeacon is not None:
        yield _spelled(f"{pointer}/altbeacon", altbeacon_key, heard.altbeacon.id)
    if heard.mac is not None and (key := _mac_key(heard.mac, f"{pointer}/mac")) is not None:
        yield key


def _spelled(pointer: str, spell: Callable[..., str], *parts: str | int) -> str:
    try:
        return spell(*parts)
    except ValueError as error:
        raise Refusal(RecordCode.WRONG_FORMAT, pointer, str(error)) from error


def _samples(rows: list[Any], width: int, count: int, name: str) -> FloatArray:
    if rows and len(rows) != count:
        raise Refusal(
            RecordCode.LENGTH_MISMATCH, f"/{name}", f"{len(rows)} samples beside {count} of acc"
        )
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _bounded(samples: FloatArray, limit: float, name: str) -> npt.NDArray[np.float32]:
    # Before the narrowing: what float32 cannot hold is beyond every limit.
    _refuse_first(np.abs(samples).max(axis=1, initial=0.0) > limit, name, f"is beyond {limit:g}")
    return samples.astype(np.float32)


def _refuse_first(wrong: npt.NDArray[np.bool_], name: str, words: str) -> None:
    if wrong.any():
        i = int(np.argmax(wrong))
        raise Refusal(RecordCode.OUT_OF_RANGE, f"/{name}/{i}", f"sample {i} {words}")
