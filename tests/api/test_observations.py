"""What becomes of a record: canonical keys, core units, the phone's own time."""

import math

import msgspec
import numpy as np
import pytest
from api_server import UUID

from app.api.ingest_decode import decode_records
from app.core.types import BleScan, ImuBlock, Observation, Pedometer, Steps, WifiScan
from app.sessions.batch import IncomingRecord


def taken(record: dict[str, object]) -> IncomingRecord:
    raw = msgspec.Raw(msgspec.json.encode(record))
    decoded = decode_records([raw], may_state_truth=True)
    assert decoded.rejected == ()
    (incoming,) = decoded.accepted
    return incoming


def observed(record: dict[str, object]) -> Observation:
    return taken({"t_ms": 2000, **record}).observation


def digest(*records: dict[str, object]) -> bytes:
    raws = [msgspec.Raw(msgspec.json.encode(record)) for record in records]
    return decode_records(raws, may_state_truth=True).digest


def wifi(*aps: dict[str, object]) -> WifiScan:
    scan = observed({"k": "wifi", "aps": list(aps)})
    assert isinstance(scan, WifiScan)
    return scan


@pytest.mark.parametrize(
    "bssid",
    ["02:42:AC:11:00:01", "0242ac110001", "02-42-ac-11-00-01", "0242.AC11.0001"],
)
def test_addresses_have_one_spelling(bssid: str) -> None:
    (reading,) = wifi({"bssid": bssid, "rssi": -48, "age_ms": 120}).readings
    assert (reading.keys, reading.rssi_dbm, reading.age_s) == (("mac:0242ac110001",), -48.0, 0.12)


def test_of_duplicate_access_points_the_strongest_counts_the_fresher_at_a_tie() -> None:
    name = "02:42:ac:11:00:01"
    readings = wifi(
        {"bssid": name, "rssi": -60, "age_ms": 0},
        {"bssid": name.upper(), "rssi": -50, "age_ms": 900},
        {"bssid": name, "rssi": -50, "age_ms": 100},
        {"bssid": name, "rssi": -50, "age_ms": 500},
    ).readings
    assert [(r.rssi_dbm, r.age_s) for r in readings] == [(-50.0, 0.1)]


@pytest.mark.parametrize("rssi", [0, 20, 127, -127, -200, 1e300])
def test_levels_that_mean_absence_are_left_out(rssi: float) -> None:
    aps = [{"bssid": "0242ac110001", "rssi": rssi}, {"bssid": "0242ac110002", "rssi": -70}]
    assert [r.keys for r in wifi(*aps).readings] == [("mac:0242ac110002",)]


@pytest.mark.parametrize("rssi", [19, 1, -1, -126])
def test_levels_at_the_bounds_are_kept(rssi: float) -> None:
    assert len(wifi({"bssid": "0242ac110001", "rssi": rssi}).readings) == 1


def test_beacon_keys_come_most_specific_first() -> None:
    scan = observed(
        {
            "k": "ble",
            "beacons": [
                {
                    "mac": "C2:00:7D:00:00:AA",
                    "altbeacon": {"id": "A" * 40},
                    "eddystone": {"namespace": "B" * 20, "instance": "C" * 12},
                    "ibeacon": {"uuid": UUID.upper().replace("-", ""), "major": 1, "minor": 7},
                    "rssi": -71,
                },
                {"mac": "02:00:00:00:00:00", "rssi": -50},
            ],
        }
    )
    assert isinstance(scan, BleScan)
    (reading,) = scan.readings
    assert reading.keys == (
        f"ibeacon:{UUID}:1:7",
        f"eddystone:{'b' * 20}:{'c' * 12}",
        f"altbeacon:{'a' * 40}",
        "mac:c2007d0000aa",
    )


@pytest.mark.parametrize(
    ("heading_deg", "heading_rad"),
    [(0, math.pi / 2), (90, 0.0), (180, -math.pi / 2), (-45, 3 * math.pi / 4), (360, math.pi / 2)],
)
def test_headings_turn_from_compass_to_plan(heading_deg: float, heading_rad: float) -> None:
    step = observed({"k": "step", "heading_deg": heading_deg, "heading_std_deg": 90})
    assert isinstance(step, Steps)
    assert step.heading_rad == pytest.approx(heading_rad)
    assert step.heading_sigma_rad == pytest.approx(math.pi / 2)


def test_monotonic_time_is_preferred() -> None:
    incoming = taken({"k": "step", "t_ms": 5000, "mono_ms": 1250})
    assert (incoming.monotonic, incoming.observation.time_s) == (True, 1.25)
    incoming = taken({"k": "step", "t_ms": 5000})
    assert (incoming.monotonic, incoming.observation.time_s) == (False, 5.0)


def test_a_pedometer_interval_needs_both_ends_of_one_clock() -> None:
    incoming = taken(
        {"k": "pedometer", "t0_ms": 0, "t1_ms": 9000, "mono0_ms": 5000, "steps": 9, "dist_m": 6.6}
    )
    assert incoming.monotonic is False
    assert incoming.observation == Pedometer(begin_s=0.0, time_s=9.0, steps=9, distance_m=6.6)


def test_inertial_samples_become_float32_arrays() -> None:
    samples = [[0.1, 0.2, 9.8], [0.1, 0.3, 9.9]]
    block = observed({"k": "imu", "t0_ms": 500, "rate_hz": 50, "acc": samples, "gyro": samples})
    assert isinstance(block, ImuBlock)
    assert block.time_s == 0.5
    for array, shape in [
        (block.acc_mps2, (2, 3)),
        (block.gyro_radps, (2, 3)),
        (block.mag_ut, (0, 3)),
        (block.quat_wxyz, (0, 4)),
    ]:
        assert (array.dtype, array.shape) == (np.dtype(np.float32), shape)
    assert np.array_equal(block.acc_mps2, np.array(samples, dtype=np.float32))


def test_the_digest_tells_meanings_not_spellings() -> None:
    scan = {"k": "wifi", "t_ms": 2000, "aps": [{"bssid": "0242ac110001", "rssi": -48}]}
    same = {
        "vendor": 1,
        "aps": [{"rssi": -48.0, "bssid": "0242ac110001"}],
        "t_ms": 2e3,
        "k": "wifi",
    }
    louder = {**scan, "aps": [{"bssid": "0242ac110001", "rssi": -47}]}
    assert digest(scan) == digest(same)
    assert len({digest(scan), digest(louder), digest(), digest(scan, scan)}) == 4
    assert digest({"k": "tea"}) != digest({"k": "coffee"})
