"""Records that are rejected, each with its code and pointer, and odd ones that are taken."""

import json
import math
from typing import Any

from api_server import NOW_S, UUID, ble_record

NOW_MS = NOW_S * 1000.0
HOUR_MS = 3_600_000.0
GOOD = ble_record(6.0, 4.0, NOW_MS)


def without(body: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in body.items() if key != name}


def wifi(**ap: object) -> dict[str, Any]:
    return {"k": "wifi", "t_ms": NOW_MS, "aps": [{"bssid": "02:42:ac:11:00:01", "rssi": -48, **ap}]}


def ble(**beacon: object) -> dict[str, Any]:
    frame = {"uuid": UUID, "major": 1, "minor": 7}
    return {"k": "ble", "t_ms": NOW_MS, "beacons": [{"ibeacon": frame, "rssi": -71, **beacon}]}


def ibeacon(**changed: object) -> dict[str, Any]:
    return ble(ibeacon={"uuid": UUID, "major": 1, "minor": 7, **changed})


def step(**fields: object) -> dict[str, Any]:
    return {"k": "step", "t_ms": NOW_MS, **fields}


def pedometer(**fields: object) -> dict[str, Any]:
    return {"k": "pedometer", "t0_ms": NOW_MS - 9000, "t1_ms": NOW_MS, "steps": 9, **fields}


def imu(**fields: object) -> dict[str, Any]:
    acc = [[0.1, 0.2, 9.8], [0.1, 0.3, 9.9]]
    return {"k": "imu", "t0_ms": NOW_MS, "rate_hz": 50, "acc": acc, **fields}


def baro(**fields: object) -> dict[str, Any]:
    return {"k": "baro", "t_ms": NOW_MS, "hpa": 1013.2, **fields}


def truth(**fields: object) -> dict[str, Any]:
    return {"k": "truth", "t_ms": NOW_MS, "x": 1.0, "y": 2.0, "floor_id": "lab-0", **fields}


def raw(record: object) -> bytes:
    """Return a record as most serialisers write it: NaN and Infinity as they are."""
    return json.dumps(record).encode()


# name, record, code, pointer inside the record
REJECTED: list[tuple[str, object, str, str]] = [
    ("a number", 5, "wrong_type", ""),
    ("null", None, "wrong_type", ""),
    ("an array", [], "wrong_type", ""),
    ("no kind", {"t_ms": NOW_MS}, "missing_field", "/k"),
    ("kind is a number", {"k": 5}, "wrong_type", "/k"),
    # Times.
    ("no time", without(GOOD, "t_ms"), "time_missing", ""),
    ("time is null", {**GOOD, "t_ms": None}, "time_missing", ""),
    ("time is text", {**GOOD, "t_ms": "2026-11-22T02:20:00Z"}, "wrong_type", "/t_ms"),
    ("time negative", {**GOOD, "t_ms": -1}, "out_of_range", "/t_ms"),
    ("time in seconds", {**GOOD, "t_ms": NOW_S}, "too_old", ""),
    ("time in nanoseconds", {**GOOD, "t_ms": NOW_S * 1e9}, "out_of_range", "/t_ms"),
    ("time beyond floats", b'{"k":"ble","t_ms":1e999,"beacons":[]}', "out_of_range", "/t_ms"),
    ("time in the past", {**GOOD, "t_ms": NOW_MS - 25 * HOUR_MS}, "too_old", ""),
    ("time in the future", {**GOOD, "t_ms": NOW_MS + 301_000}, "in_future", ""),
    (
        "a block reaching into the future",
        imu(t0_ms=NOW_MS + 299_500, acc=[[0, 0, 9.8]] * 100),
        "in_future",
        "",
    ),
    ("monotonic time is text", {**GOOD, "mono_ms": "5000"}, "wrong_type", "/mono_ms"),
    # NaN and Infinity, which are no JSON.
    ("NaN as time", raw({**GOOD, "t_ms": math.nan}), "wrong_type", "/t_ms"),
    ("Infinity as time", raw({**GOOD, "t_ms": math.inf}), "wrong_type", "/t_ms"),
    ("minus Infinity as time", raw({**GOOD, "t_ms": -math.inf}), "wrong_type", "/t_ms"),
    ("NaN as heading", raw(step(heading_deg=math.nan)), "wrong_type", "/heading_deg"),
    ("NaN as sample", raw(imu(acc=[[0, 0, 9.8], [0, math.nan, 9.8]])), "wrong_type", "/acc/1/1"),
    ("NaN in place of a record", b"NaN", "wrong_type", ""),
    # Wi-Fi.
    ("no aps", {"k": "wifi", "t_ms": NOW_MS}, "missing_field", "/aps"),
    ("aps is an object", {"k": "wifi", "t_ms": NOW_MS, "aps": {}}, "wrong_type", "/aps"),
    (
        "too many aps",
        {"k": "wifi", "t_ms": NOW_MS, "aps": [wifi()["aps"][0]] * 1001},
        "too_long",
        "/aps",
    ),
    ("an ap is a number", {"k": "wifi", "t_ms": NOW_MS, "aps": [5]}, "wrong_type", "/aps/0"),
    (
        "no bssid",
        {"k": "wifi", "t_ms": NOW_MS, "aps": [{"rssi": -48}]},
        "missing_field",
        "/aps/0/bssid",
    ),
    ("bssid is a number", wifi(bssid=1), "wrong_type", "/aps/0/bssid"),
    ("bssid too long", wifi(bssid="02" * 17), "too_long", "/aps/0/bssid"),
    ("bssid too short", wifi(bssid="02:42:ac"), "wrong_format", "/aps/0/bssid"),
    ("bssid not hexadecimal", wifi(bssid="zz:42:ac:11:00:01"), "wrong_format", "/aps/0/bssid"),
    ("bssid of other digits", wifi(bssid="\u0660\u066242ac110001"), "wrong_format", "/aps/0/bssid"),
    (
        "no rssi",
        {"k": "wifi", "t_ms": NOW_MS, "aps": [{"bssid": "0242ac110001"}]},
        "missing_field",
        "/aps/0/rssi",
    ),
    ("rssi is text", wifi(rssi="-48"), "wrong_type", "/aps/0/rssi"),
    ("rssi is null", wifi(rssi=None), "wrong_type", "/aps/0/rssi"),
    ("age is text", wifi(age_ms="1"), "wrong_type", "/aps/0/age_ms"),
    ("age negative", wifi(age_ms=-1), "out_of_range", "/aps/0/age_ms"),
    ("frequency in GHz", wifi(freq=2.412), "out_of_range", "/aps/0/freq"),
    ("frequency in Hz", wifi(freq=2.412e9), "out_of_range", "/aps/0/freq"),
    ("ssid is a number", wifi(ssid=5), "wrong_type", "/aps/0/ssid"),
    ("ssid too long", wifi(ssid="x" * 101), "too_long", "/aps/0/ssid"),
    # BLE.
    ("no beacons", {"k": "ble", "t_ms": NOW_MS}, "missing_field", "/beacons"),
    ("beacons is text", {"k": "ble", "t_ms": NOW_MS, "beacons": "x"}, "wrong_type", "/beacons"),
    ("too many beacons", {**ble(), "beacons": ble()["beacons"] * 1001}, "too_long", "/beacons"),
    ("no identity", ble(ibeacon=None), "missing_field", "/beacons/0"),
    (
        "beacon without level",
        {**ble(), "beacons": [{"mac": "0242ac110001"}]},
        "missing_field",
        "/beacons/0/rssi",
    ),
    ("level is a list", ble(rssi=[-71]), "wrong_type", "/beacons/0/rssi"),
    ("ibeacon is text", ble(ibeacon="x"), "wrong_type", "/beacons/0/ibeacon"),
    ("no uuid", ble(ibeacon={"major": 1, "minor": 7}), "missing_field", "/beacons/0/ibeacon/uuid"),
    ("uuid too short", ibeacon(uuid="f7826da6"), "wrong_format", "/beacons/0/ibeacon"),
    ("uuid too long", ibeacon(uuid="f" * 41), "too_long", "/beacons/0/ibeacon/uuid"),
    ("major is text", ibeacon(major="1"), "wrong_type", "/beacons/0/ibeacon/major"),
    ("major too large", ibeacon(major=65536), "out_of_range", "/beacons/0/ibeacon/major"),
    ("minor negative", ibeacon(minor=-1), "out_of_range", "/beacons/0/ibeacon/minor"),
    (
        "eddystone without instance",
        ble(eddystone={"namespace": "0" * 20}),
        "missing_field",
        "/beacons/0/eddystone/instance",
    ),
    (
        "eddystone of wrong length",
        ble(eddystone={"namespace": "0", "instance": "0" * 12}),
        "wrong_format",
        "/beacons/0/eddystone",
    ),
    (
        "altbeacon not hexadecimal",
        ble(altbeacon={"id": "x" * 40}),
        "wrong_format",
        "/beacons/0/altbeacon",
    ),
    ("mac of wrong form", ble(mac="5"), "wrong_format", "/beacons/0/mac"),
    ("beacon age in the future", ble(age_ms=-20), "out_of_range", "/beacons/0/age_ms"),
    ("power out of range", ble(tx1m=-300), "out_of_range", "/beacons/0/tx1m"),
    ("count is a fraction", ble(n=1.5), "wrong_type", "/beacons/0/n"),
    # Steps.
    ("no step", step(n=0), "out_of_range", "/n"),
    ("steps is text", step(n="1"), "wrong_type", "/n"),
    ("too many steps at once", step(n=101), "out_of_range", "/n"),
    ("step length in cm", step(len_m=71), "out_of_range", "/len_m"),
    ("step length zero", step(len_m=0), "out_of_range", "/len_m"),
    ("heading is text", step(heading_deg="north"), "wrong_type", "/heading_deg"),
    ("heading out of range", step(heading_deg=4000), "out_of_range", "/heading_deg"),
    ("heading spread negative", step(heading_std_deg=-1), "out_of_range", "/heading_std_deg"),
    # Pedometer.
    ("no steps", without(pedometer(), "steps"), "missing_field", "/steps"),
    ("steps negative", pedometer(steps=-1), "out_of_range", "/steps"),
    ("interval without end", without(pedometer(), "t1_ms"), "time_missing", ""),
    ("interval backwards", pedometer(t1_ms=NOW_MS - 10_000), "time_order", ""),
    ("distance in cm", pedometer(dist_m=66_000), "out_of_range", "/dist_m"),
    ("floors are text", pedometer(floors_up="1"), "wrong_type", "/floors_up"),
    # Inertial blocks.
    ("no rate", without(imu(), "rate_hz"), "missing_field", "/rate_hz"),
    ("rate zero", imu(rate_hz=0), "out_of_range", "/rate_hz"),
    ("rate in mHz", imu(rate_hz=50_000), "out_of_range", "/rate_hz"),
    ("no samples", imu(acc=[]), "length_mismatch", "/acc"),
    ("no acc", without(imu(), "acc"), "missing_field", "/acc"),
    ("too many samples", imu(acc=[[0, 0, 9.8]] * 2001), "too_long", "/acc"),
    ("sample of two", imu(acc=[[0, 9.8]]), "length_mismatch", "/acc/0"),
    ("sample of four", imu(acc=[[0, 0, 0, 9.8]]), "length_mismatch", "/acc/0"),
    ("sample is text", imu(acc=[["0", 0, 9.8]]), "wrong_type", "/acc/0/0"),
    ("sample is null", imu(acc=[None]), "wrong_type", "/acc/0"),
    ("acc beyond any phone", imu(acc=[[0, 0, 9.8], [0, 0, 9800]]), "out_of_range", "/acc/1"),
    ("acc beyond float32", imu(acc=[[0, 0, 1e300]]), "out_of_range", "/acc/0"),
    ("gyro shorter than acc", imu(gyro=[[0, 0, 0]]), "length_mismatch", "/gyro"),
    ("gyro in degrees", imu(gyro=[[0, 0, 0], [0, 0, 500]]), "out_of_range", "/gyro/1"),
    ("mag longer than acc", imu(mag=[[20, -5, -40]] * 3), "length_mismatch", "/mag"),
    ("mag in nT", imu(mag=[[20_000, -5000, -40_000]] * 2), "out_of_range", "/mag/0"),
    ("quat of three", imu(quat=[[1, 0, 0]] * 2), "length_mismatch", "/quat/0"),
    ("quat not a rotation", imu(quat=[[1, 0, 0, 0], [0, 0, 0, 0]]), "out_of_range", "/quat/1"),
    ("quat in g", imu(quat=[[9.8, 0, 0, 0]] * 2), "out_of_range", "/quat/0"),
    ("block without time", without(imu(), "t0_ms"), "time_missing", ""),
    # Pressure and truth.
    ("no pressure", without(baro(), "hpa"), "missing_field", "/hpa"),
    ("pressure in Pa", baro(hpa=101_320), "out_of_range", "/hpa"),
    ("pressure in kPa", baro(hpa=101.3), "out_of_range", "/hpa"),
    ("pressure is text", baro(hpa="1013"), "wrong_type", "/hpa"),
    ("truth by a phone", truth(), "role_forbidden", "/k"),
    ("truth without floor", without(truth(), "floor_id"), "missing_field", "/floor_id"),
    ("truth in degrees of a projection", truth(x=4.5e6), "out_of_range", "/x"),
    ("note too long", truth(note="x" * 501), "too_long", "/note"),
]


ODD: list[tuple[str, dict[str, Any]]] = [
    ("unknown transmitters", ble(mac="aa:bb:cc:dd:ee:ff")),
    ("an empty Wi-Fi scan", {"k": "wifi", "t_ms": NOW_MS, "aps": []}),
    ("an empty BLE scan", {"k": "ble", "t_ms": NOW_MS, "beacons": []}),
    ("rssi 0", ble(rssi=0)),
    ("rssi 127", ble(rssi=127)),
    ("rssi -127", wifi(rssi=-127)),
    ("rssi huge", wifi(rssi=1e300)),
    ("a hidden address", wifi(bssid="02:00:00:00:00:00")),
    ("duplicate BSSIDs", {"k": "wifi", "t_ms": NOW_MS, "aps": wifi()["aps"] * 2}),
    ("unknown fields", {**wifi(channelWidth=2), "vendor": {"x": [1]}}),
    ("time going back", {**GOOD, "t_ms": NOW_MS - 2000}),
    ("time going far back", {**GOOD, "t_ms": NOW_MS - HOUR_MS}),
    ("no inertial neighbours", imu(gyro=[], mag=[], quat=[])),
]
