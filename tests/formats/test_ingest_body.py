"""What a phone posts comes back as the same observations."""

import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stnp

from app.api.ingest_decode import decode_body, decode_records
from app.api.ingest_schema import Batch
from app.core.engine import order_key
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
from app.formats.ingest_body import ingest_body, record_of
from app.formats.transmitters import altbeacon_key, eddystone_key, ibeacon_key, mac_key

HEADER: dict[str, Any] = {
    "device": {"id": "phone-1"},
    "session": "s",
    "clock": {"mode": "recorded"},
}

# Phones stamp in whole milliseconds or finer; the body tells microseconds.
times_s = st.integers(10**12, 2 * 10**12).map(lambda ms: ms / 1000.0)
ages_s = st.integers(0, 10**6).map(lambda ms: ms / 1000.0)
levels_dbm = st.floats(-126.5, -1.0)


def hexadecimal(length: int) -> st.SearchStrategy[str]:
    return st.text("0123456789abcdef", min_size=length, max_size=length)


# Android's two placeholder addresses count as no address: the decoder drops them.
mac_keys = hexadecimal(12).filter(lambda d: d not in {"0" * 12, "020000000000"}).map(mac_key)
uint16 = st.integers(0, 0xFFFF)
beacon_keys = st.tuples(
    st.none() | st.builds(ibeacon_key, hexadecimal(32), uint16, uint16),
    st.none() | st.builds(eddystone_key, hexadecimal(20), hexadecimal(12)),
    st.none() | hexadecimal(40).map(altbeacon_key),
    st.none() | mac_keys,
).map(lambda keys: tuple(key for key in keys if key is not None))


def distinct_readings(keys: st.SearchStrategy[tuple[str, ...]]) -> st.SearchStrategy[Any]:
    reading = st.builds(Reading, keys, levels_dbm, ages_s)
    return st.lists(reading, max_size=5, unique_by=lambda r: r.keys).map(tuple)


wifi_scans = st.builds(WifiScan, times_s, distinct_readings(mac_keys.map(lambda k: (k,))))
ble_scans = st.builds(BleScan, times_s, distinct_readings(beacon_keys.filter(bool)))
steps = st.builds(Steps, times_s, st.integers(1, 100), st.none() | st.floats(0.1, 3.0))
pedometers = st.builds(
    lambda t_s, length_s, n, d, up: Pedometer(t_s, t_s + length_s, n, d, up, 0),
    times_s.map(float.__floor__).map(float),
    st.integers(0, 100).map(float),
    st.integers(0, 10_000),
    st.none() | st.floats(0, 20_000),
    st.integers(0, 10),
)
barometers = st.builds(Barometer, times_s, st.floats(300, 1200))
truths = st.builds(Truth, times_s, st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.just("f1"))


@st.composite
def imu_blocks(draw: st.DrawFn) -> ImuBlock:
    count = draw(st.integers(1, 4))

    def samples(limit: float) -> np.ndarray:
        rows = draw(st.sampled_from([0, count]))
        elements = st.floats(-limit, limit, width=32)
        return draw(stnp.arrays(np.float32, (rows, 3), elements=elements))

    acc = draw(stnp.arrays(np.float32, (count, 3), elements=st.floats(-256, 256, width=32)))
    angle = draw(st.floats(-3, 3))
    quat = np.array([[math.cos(angle), math.sin(angle), 0, 0]] * count, dtype=np.float32)
    rate_hz = draw(st.floats(1, 1000))
    return ImuBlock(draw(times_s), rate_hz, acc, samples(64), samples(4096), quat)


observations = st.one_of(wifi_scans, ble_scans, steps, pedometers, barometers, truths, imu_blocks())


def decoded(body: bytes) -> list[Observation]:
    batch = decode_body(body, msgspec.json.Decoder(Batch))
    records = decode_records(batch.records, may_state_truth=True)
    assert not records.rejected
    assert not records.ignored
    return [record.observation for record in records.accepted]


@given(st.lists(observations, max_size=4))
def test_the_server_decodes_what_was_encoded(sent: list[Observation]) -> None:
    received = decoded(ingest_body(HEADER, 7, sent))
    # The order key holds time, kind and a digest of everything else, samples bit by bit.
    assert [order_key(o) for o in received] == [order_key(o) for o in sent]


@given(st.floats(-math.pi, math.pi - 1e-9), st.floats(0.01, 3.0))
def test_headings_come_back_to_a_rounding_error(heading_rad: float, sigma_rad: float) -> None:
    (received,) = decoded(ingest_body(HEADER, 0, [Steps(1.0, 1, 0.7, heading_rad, sigma_rad)]))
    assert isinstance(received, Steps)
    assert received.heading_rad is not None
    assert math.cos(received.heading_rad - heading_rad) == pytest.approx(1.0, abs=1e-15)
    assert received.heading_sigma_rad == pytest.approx(sigma_rad, rel=1e-14)


def test_headings_are_told_clockwise_from_north() -> None:
    west = record_of(Steps(1.0, 1, heading_rad=math.pi))
    assert west["heading_deg"] == 270.0


def test_what_is_unknown_is_left_out() -> None:
    assert record_of(Steps(2.0, 3)) == {"k": "step", "t_ms": 2000.0, "n": 3}


def test_the_envelope_is_the_header_with_number_and_records() -> None:
    body = json.loads(ingest_body(HEADER, 3, [Barometer(1.5, 1000.0)]))
    assert body == {**HEADER, "seq": 3, "records": [{"k": "baro", "t_ms": 1500.0, "hpa": 1000.0}]}


def test_samples_are_told_in_few_digits() -> None:
    empty = np.empty((0, 3), np.float32)
    acc = np.array([[0.1, -9.80665, 1e-7]], np.float32)
    block = ImuBlock(1.0, 50.0, acc, empty, empty, np.empty((0, 4), np.float32))
    assert b"[0.1,-9.80665,1e-7]" in msgspec.json.encode(record_of(block))
