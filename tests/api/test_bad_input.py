"""Malformed and hostile bodies: every class of them has its status and its stable code."""

import gzip
import itertools
import json
import math
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
import pytest
from api_server import NOW_S, ApiServer, batch, serving
from bad_records import GOOD, ODD, REJECTED, baro, without
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.api.ingest_decode import decode_body
from app.api.ingest_schema import Batch
from app.services.errors import AppError, ErrorCode

pytestmark = pytest.mark.anyio

JSON_TYPE = {"Content-Type": "application/json"}
GZIP = {**JSON_TYPE, "Content-Encoding": "gzip"}
SESSIONS = itertools.count()


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
    malformed("nan in lower case", PREFIX + b"[nan]}"),
    malformed("NaN and cut off", text(fresh({**GOOD, "t_ms": math.nan}))[:-5]),
    envelope("NaN in a field", "#/clock/sent_ms", clock={"sent_ms": math.nan}),
    envelope("Infinity as a clock", "#/clock/mono_ms", clock={"mono_ms": math.inf}),
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
    assert answer["fix"]["x"] == pytest.approx(6.0, abs=1.5)


async def test_nan_counts_only_where_a_number_must_be(server: ApiServer) -> None:
    """In a field that nobody reads it harms as little as any other content."""
    odd = {**GOOD, "vendor": [math.nan, -math.inf, 'a "NaN" \\']}
    async with server.client("phone-7") as client:
        reply = await client.post("/v1/ingest", content=text(fresh(odd)), headers=JSON_TYPE)
    assert (reply.json()["accepted"], reply.json()["rejected"]) == (1, [])


def test_a_body_that_is_no_json_is_refused_with_its_first_wrong_byte() -> None:
    record = {**GOOD, "t_ms": math.nan}
    wrong_later = text(fresh(record, "here")).replace(b'"here"', b"here")
    large = text(fresh(record, *[GOOD] * 3000))
    assert len(large) > 1 << 20
    for content, first in ((wrong_later, b"here"), (large, b"NaN")):
        with pytest.raises(AppError, match=rf"\(byte {content.index(first)}\)") as refused:
            decode_body(content, msgspec.json.Decoder(Batch))
        assert refused.value.code is ErrorCode.MALFORMED_BODY


DOCUMENTS = st.recursive(
    st.sampled_from([math.nan, math.inf, -math.inf, 1.5, None]) | st.text(max_size=8),
    lambda part: st.lists(part, max_size=4) | st.dictionaries(st.text(max_size=8), part),
)


@given(DOCUMENTS)
def test_numbers_that_are_none_become_texts_and_texts_stay(document: object) -> None:
    names = json.loads(json.dumps(document), parse_constant=lambda name: name[1:-1])
    assert decode_body(json.dumps(document).encode(), msgspec.json.Decoder()) == names
    unescaped = json.dumps(document, ensure_ascii=False).encode()
    assert decode_body(unescaped, msgspec.json.Decoder()) == names


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
