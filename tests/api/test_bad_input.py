"""Malformed and hostile bodies: every class of them has its status and its stable code."""

import gzip
import itertools
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
import pytest
from api_server import NOW_S, UUID, ApiServer, batch, ble_record, serving
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytestmark = pytest.mark.anyio

NOW_MS = NOW_S * 1000.0
JSON_TYPE = {"Content-Type": "application/json"}
GZIP = {**JSON_TYPE, "Content-Encoding": "gzip"}
SESSIONS = itertools.count()
GOOD = ble_record(6.0, 4.0, NOW_MS)


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="module")
async def server(
    _sqlite_template: Any, tmp_path_factory: pytest.TempPathFactory, anyio_backend: str
) -> AsyncIterator[ApiServer]:
    """One application for the whole table; every case has a session of its own."""
    path = tmp_path_factory.mktemp("bad-input") / "pharos.db"
    path.write_bytes(_sqlite_template.read_bytes())
    async with serving(f"sqlite:///{path}") as running:
        yield running


def fresh(*records: object, **fields: object) -> dict[str, Any]:
    return batch(*records, **{"session": f"s{next(SESSIONS)}", **fields})


def text(body: object) -> bytes:
    return json.dumps(body).encode()


def without(body: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in body.items() if key != name}


def nested(depth: int) -> bytes:
    return b"[" * depth + b"]" * depth


@dataclass(frozen=True)
class Refused:
    """A request that is refused as a whole."""

    name: str
    content: bytes
    status: int
    code: str
    bearer: str | None = "phone-7"
    headers: dict[str, str] = field(default_factory=lambda: JSON_TYPE)
    pointer: str | None = None


def envelope(name: str, pointer: str, **fields: object) -> Refused:
    return Refused(name, text(fresh(**fields)), 422, "invalid_field", pointer=pointer)


def malformed(name: str, content: bytes) -> Refused:
    return Refused(name, content, 400, "malformed_body")


PREFIX = text(fresh())[:-3]  # up to the opening bracket of records
BOMB = gzip.compress(b'{"device": "' + b" " * (9 << 20))
SQUEEZED = gzip.compress(text(fresh()) + b" " * 2_000_000)
WHOLE = gzip.compress(text(fresh(*[GOOD] * 20)))

REFUSED = [
    # Not JSON.
    malformed("empty body", b""),
    malformed("cut off", text(fresh(GOOD))[:-5]),
    malformed("two documents", text(fresh()) + text(fresh())),
    malformed("NaN in a field", text(fresh(clock={"sent_ms": float("nan")}))),
    malformed("NaN in a record", text(fresh({**GOOD, "t_ms": float("nan")}))),
    malformed("Infinity", text(fresh({**GOOD, "t_ms": float("inf")}))),
    malformed("minus Infinity", text(fresh({**GOOD, "t_ms": float("-inf")}))),
    malformed("single quotes", b"{'device': 1}"),
    malformed("a control character", b'{"device": "a\x01"}'),
    malformed(
        "a lone surrogate", b'{"device":{"id":"\\ud800"},"session":"s","seq":0,"records":[]}'
    ),
    # Wrong encodings.
    malformed("UTF-16", json.dumps(fresh()).encode("utf-16")),
    malformed(
        "Latin-1", json.dumps(fresh(device={"id": "ü"}), ensure_ascii=False).encode("latin-1")
    ),
    malformed("bytes that are no text, in a record", PREFIX + b'["\xff\xfe"]}'),
    malformed("a byte-order mark", b"\xef\xbb\xbf" + text(fresh())),
    # Deep nesting.
    Refused("deep arrays", nested(100_000), 422, "invalid_field", pointer="#"),
    malformed("deep record", PREFIX + b"[" + nested(100_000) + b"]}"),
    malformed("deep unknown field", text(fresh())[:-1] + b',"x":' + nested(100_000) + b"}"),
    # Codings.
    Refused(
        "unknown coding",
        b"x",
        415,
        "coding_unsupported",
        headers={**JSON_TYPE, "Content-Encoding": "br"},
    ),
    Refused(
        "coding twice",
        b"x",
        415,
        "coding_unsupported",
        headers={**JSON_TYPE, "Content-Encoding": "gzip, gzip"},
    ),
    Refused("not gzip", text(fresh()), 400, "malformed_gzip", headers=GZIP),
    Refused("truncated gzip", WHOLE[:-20], 400, "malformed_gzip", headers=GZIP),
    Refused("gzip without its checksum", WHOLE[:-8], 400, "malformed_gzip", headers=GZIP),
    Refused(
        "damaged gzip", WHOLE[:60] + b"\xff" * 8 + WHOLE[68:], 400, "malformed_gzip", headers=GZIP
    ),
    Refused("garbage after gzip", WHOLE + b"garbage", 400, "malformed_gzip", headers=GZIP),
    Refused("gzip of nothing", b"", 400, "malformed_gzip", headers=GZIP),
    Refused("gzip of no JSON", gzip.compress(b"no"), 400, "malformed_body", headers=GZIP),
    Refused("gzip bomb by size", BOMB, 413, "body_too_large", headers=GZIP),
    Refused("gzip bomb by ratio", SQUEEZED, 413, "body_too_large", headers=GZIP),
    Refused("bomb in a bomb", gzip.compress(BOMB), 400, "malformed_body", headers=GZIP),
    Refused("too large", b" " * ((1 << 20) + 1), 413, "body_too_large"),
    Refused(
        "a form",
        b"device=1",
        415,
        "media_type_unsupported",
        headers={"Content-Type": "application/x-www-form-urlencoded"},
    ),
    Refused("no media type", text(fresh()), 415, "media_type_unsupported", headers={}),
    # The envelope, field by field.
    Refused("an array", b"[]", 422, "invalid_field", pointer="#"),
    Refused("a number", b"5", 422, "invalid_field", pointer="#"),
    Refused("null", b"null", 422, "invalid_field", pointer="#"),
    *(
        Refused(
            f"no {name}", text(without(fresh(), name)), 422, "invalid_field", pointer=f"#/{name}"
        )
        for name in ("device", "session", "seq", "records")
    ),
    envelope("device is text", "#/device", device="phone-7"),
    envelope("device without id", "#/device/id", device={}),
    envelope("device id is a number", "#/device/id", device={"id": 7}),
    envelope("device id is empty", "#/device/id", device={"id": ""}),
    envelope("device id too long", "#/device/id", device={"id": "x" * 65}),
    envelope("device id with a slash", "#/device/id", device={"id": "a/../b"}),
    envelope("device id with a line break", "#/device/id", device={"id": "a\nb"}),
    envelope("device id ends with a line break", "#/device/id", device={"id": "phone-7\n"}),
    envelope(
        "platform unknown", "#/device/platform", device={"id": "phone-7", "platform": "symbian"}
    ),
    envelope("model too long", "#/device/model", device={"id": "phone-7", "model": "x" * 101}),
    envelope("app is a number", "#/device/app", device={"id": "phone-7", "app": 1.4}),
    envelope("session is null", "#/session", session=None),
    envelope("session too long", "#/session", session="x" * 65),
    envelope("seq is text", "#/seq", seq="1"),
    envelope("seq is a fraction", "#/seq", seq=1.5),
    envelope("seq negative", "#/seq", seq=-1),
    envelope("seq too large", "#/seq", seq=2**53),
    envelope("seq is huge", "#/seq", seq=10**30),
    envelope("seq is true", "#/seq", seq=True),
    envelope("clock is a list", "#/clock", clock=[]),
    envelope("clock mode unknown", "#/clock/mode", clock={"mode": "replay"}),
    envelope("sent_ms is text", "#/clock/sent_ms", clock={"sent_ms": "now"}),
    envelope("sent_ms negative", "#/clock/sent_ms", clock={"sent_ms": -1}),
    envelope("sent_ms in nanoseconds", "#/clock/sent_ms", clock={"sent_ms": NOW_S * 1e9}),
    envelope("mono_ms is a list", "#/clock/mono_ms", clock={"mono_ms": [1]}),
    envelope("boot_id too long", "#/clock/boot_id", clock={"boot_id": "x" * 65}),
    envelope("records is an object", "#/records", records={}),
    envelope("too many records", "#/records", records=[0] * 5001),
    envelope("site is a number", "#/site", site=1),
    Refused(
        "site unknown", text(fresh(site="moon")), 422, "invalid_field", "admin", pointer="#/site"
    ),
    envelope("profile is a number", "#/profile", profile=1),
    envelope("profile is unknown", "#/profile", profile="worst"),
    Refused(
        "a number beyond floats",
        PREFIX.replace(b'"seq": 0', b'"seq": 1e999') + b"[]}",
        422,
        "invalid_field",
        pointer="#/seq",
    ),
    # Who asks.
    Refused("no token", text(fresh()), 401, "token_missing", bearer=None),
    Refused(
        "wrong token",
        text(fresh()),
        401,
        "token_invalid",
        bearer=None,
        headers={**JSON_TYPE, "Authorization": "Bearer pharos_wrong"},
    ),
    Refused(
        "another scheme",
        text(fresh()),
        401,
        "token_missing",
        bearer=None,
        headers={**JSON_TYPE, "Authorization": "Basic cGhhcm9z"},
    ),
    Refused(
        "empty token",
        text(fresh()),
        401,
        "token_missing",
        bearer=None,
        headers={**JSON_TYPE, "Authorization": "Bearer "},
    ),
    Refused("expired token", text(fresh()), 401, "token_expired", bearer="expired"),
    Refused("revoked token", text(fresh()), 401, "token_invalid", bearer="revoked"),
    Refused("a viewer", text(fresh()), 403, "role_forbidden", bearer="viewer"),
    Refused("a supervisor", text(fresh()), 403, "role_forbidden", bearer="supervisor"),
    Refused("another device", text(fresh(device={"id": "phone-8"})), 403, "device_forbidden"),
    Refused("a device outside the prefix", text(fresh()), 403, "device_forbidden", bearer="fleet"),
    Refused("another site", text(fresh(site="annex")), 403, "site_forbidden"),
    Refused(
        "a surveyor of another site",
        text(fresh(site="lab")),
        403,
        "site_forbidden",
        bearer="annex-surveyor",
    ),
    Refused(
        "a recording by a phone", text(fresh(clock={"mode": "recorded"})), 403, "role_forbidden"
    ),
    Refused(
        "no site to choose",
        text(fresh(device={"id": "nowhere"})),
        422,
        "site_required",
        bearer="admin",
    ),
]


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.name)
async def test_the_request_is_refused(server: ApiServer, case: Refused) -> None:
    async with server.client(case.bearer) as client:
        reply = await client.post("/v1/ingest", content=case.content, headers=case.headers)
    document = reply.json()
    assert (reply.status_code, document.get("code")) == (case.status, case.code), document
    assert reply.headers["content-type"] == "application/problem+json"
    assert document["status"] == case.status
    assert document["request_id"] == reply.headers["x-request-id"]
    if case.pointer is not None:
        assert [error["pointer"] for error in document["errors"]] == [case.pointer]
    if case.status == 401:
        assert reply.headers["www-authenticate"].startswith("Bearer")
    if case.code == "coding_unsupported":
        assert "gzip" in reply.headers["accept-encoding"]


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


HOUR_MS = 3_600_000.0

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
    ("monotonic time without a clock", {**without(GOOD, "t_ms"), "mono_ms": 5000}, "no_clock", ""),
    ("monotonic time is text", {**GOOD, "mono_ms": "5000"}, "wrong_type", "/mono_ms"),
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


@pytest.mark.parametrize(("name", "record", "code", "pointer"), REJECTED, ids=lambda v: str(v)[:40])
async def test_the_record_is_rejected_and_its_neighbours_are_kept(
    server: ApiServer, name: str, record: object, code: str, pointer: str
) -> None:
    bad = msgspec.Raw(record) if isinstance(record, bytes) else record
    body = msgspec.json.encode(fresh(GOOD, bad, baro()))
    async with server.client("phone-7") as client:
        reply = await client.post("/v1/ingest", content=body, headers=JSON_TYPE)
    answer = reply.json()
    assert reply.status_code == 200, answer
    found = [(r["i"], r["code"], r["pointer"]) for r in answer["rejected"]]
    assert found == [(1, code, f"#/records/1{pointer}")], name
    assert answer["accepted"] == 2
    assert answer["fix"]["x"] == pytest.approx(6.0, abs=1.0)


# name, record, readings left
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


@pytest.mark.parametrize(("name", "record"), ODD, ids=lambda v: str(v)[:40])
async def test_odd_records_are_taken(server: ApiServer, name: str, record: object) -> None:
    async with server.client("phone-7") as client:
        reply = await client.post("/v1/ingest", json=fresh(GOOD, record))
    answer = reply.json()
    assert (reply.status_code, answer["accepted"], answer["rejected"]) == (200, 2, []), name


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=20,
)
KINDS = ["wifi", "ble", "step", "pedometer", "imu", "baro", "truth", "rtt"]
FIELDS = [
    *("t_ms", "mono_ms", "t0_ms", "t1_ms", "aps", "beacons", "n", "len_m", "heading_deg", "steps"),
    *("rate_hz", "acc", "gyro", "mag", "quat", "hpa", "x", "y", "floor_id", "dist_m", "mono0_ms"),
]
RECORDS = st.builds(
    lambda kind, fields: {"k": kind, **fields},
    st.sampled_from(KINDS),
    st.dictionaries(st.sampled_from(FIELDS), JSON_VALUES, max_size=6),
)
BODIES = JSON_VALUES | st.builds(
    fresh, RECORDS | JSON_VALUES, RECORDS, clock=st.just({}) | JSON_VALUES
)


@settings(
    max_examples=80,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(body=BODIES)
async def test_no_json_makes_the_server_fail(server: ApiServer, body: object) -> None:
    async with server.client("surveyor") as client:
        for path in ("/v1/ingest", "/v1/locate"):
            reply = await client.post(path, content=msgspec.json.encode(body), headers=JSON_TYPE)
            assert reply.status_code in {200, 400, 403, 409, 422}, reply.text
