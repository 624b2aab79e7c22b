import dataclasses
import enum
from dataclasses import dataclass, field
from typing import Literal, Optional

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from app.core.engine import SessionState, order_key
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.types import (
    Barometer,
    BleScan,
    ImuBlock,
    NoFix,
    NoFixReason,
    Observation,
    Pedometer,
    Reading,
    Steps,
    Truth,
    WifiScan,
)
from app.storage.codec import SchemaError, TreeCodec, VariantCodec
from app.storage.log_rows import OBSERVATIONS

reals = st.floats(allow_nan=False)
counts = st.integers(0, 2**40)
maybe = st.none() | reals
readings = st.builds(
    Reading, st.lists(st.text(max_size=20), min_size=1, max_size=3).map(tuple), reals, reals
)
scans = st.lists(readings, max_size=5).map(tuple)


def samples(columns: int) -> st.SearchStrategy[np.ndarray]:
    return npst.arrays(np.float32, st.tuples(st.integers(0, 6), st.just(columns)))


observations = st.one_of(
    st.builds(WifiScan, reals, scans),
    st.builds(BleScan, reals, scans),
    st.builds(Steps, reals, counts, maybe, maybe, maybe),
    st.builds(Pedometer, reals, reals, counts, maybe, counts, counts),
    st.builds(ImuBlock, reals, reals, samples(3), samples(3), samples(3), samples(4)),
    st.builds(Barometer, reals, reals),
    st.builds(Truth, reals, reals, reals, st.text(max_size=9), st.text(max_size=9)),
)


@given(st.lists(observations, max_size=6))
def test_observations_come_back_bit_for_bit(given_observations: list[Observation]):
    decoded = OBSERVATIONS.decode(OBSERVATIONS.encode(given_observations))
    # repr shows every bit of a float and the sign of a zero; the order key digests raw samples.
    assert [type(o) for o in decoded] == [type(o) for o in given_observations]
    assert [repr(order_key(o)) for o in decoded] == [repr(order_key(o)) for o in given_observations]


def test_a_pedometer_interval_keeps_its_place_in_the_log():
    # The first two numbers have always been begin and end, whatever their fields are called.
    (kind, values), *_ = msgspec.msgpack.decode(OBSERVATIONS.encode([Pedometer(5.0, 9.0, 7)])[1:])
    assert (kind, values[:3]) == ("pedometer", [5.0, 9.0, 7])
    assert OBSERVATIONS.decode(OBSERVATIONS.encode([Pedometer(5.0, 9.0, 7)]))[0].time_s == 9.0


def test_whole_numbers_in_float_fields_stay_what_they_were():
    scan = WifiScan(5, (Reading(("mac:000000000001",), -60),))
    assert repr(OBSERVATIONS.decode(OBSERVATIONS.encode([scan]))) == repr((scan,))


def test_imu_samples_can_be_written_to_and_keep_dtype_and_shape():
    empty = np.empty((0, 3), np.float32)
    acc = np.arange(6, dtype=np.float32).reshape(2, 3)
    block = ImuBlock(1.0, 50.0, acc, empty, empty, np.empty((0, 4), np.float32))
    (decoded,) = OBSERVATIONS.decode(OBSERVATIONS.encode([block]))
    assert decoded.acc_mps2.flags.writeable
    assert decoded.acc_mps2.dtype == np.float32
    assert decoded.quat_wxyz.shape == (0, 4)


class Gait(enum.IntEnum):
    SLOW = 1
    FAST = 2


@dataclass(frozen=True, slots=True)
class Leg:
    name: str
    samples: np.ndarray
    gait: Gait | None = None


@dataclass(frozen=True, slots=True)
class Body:
    legs: tuple[Leg, ...]
    key: tuple[float, int, bytes] | None
    pending: tuple[Observation, ...]
    last: Observation | NoFix | None
    by_place: dict[tuple[int, int], Leg]
    weights: dict[str, float]
    pair: tuple[Leg, Optional["Body"]] | None
    mode: Literal["a", "b"]
    counter: int
    level: float | int
    flag: bool
    total: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", sum(self.weights.values()))


def body(**changes: object) -> Body:
    arrays = [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.array([True, False]),
        np.array(3.5),
        np.empty((0, 2)),
    ]
    legs = tuple(Leg(str(i), array, Gait.FAST) for i, array in enumerate(arrays))
    values: dict[str, object] = {
        "legs": legs,
        "key": (0.1, 2, b"\x00\xff"),
        "pending": (Barometer(1.0, 1013.25), WifiScan(2.0, (Reading(("k",), -60.5),))),
        "last": NoFix(2.0, NoFixReason.NOT_STARTED),
        "by_place": {(1, 2): Leg("there", np.zeros(1))},
        "weights": {"a": 0.1, "b": -0.0},
        "pair": None,
        "mode": "b",
        "counter": 2**64 - 1,
        "level": np.float64(0.1),
        "flag": True,
    }
    return Body(**{**values, **changes})


BODIES = TreeCodec(Body)


def test_a_tree_of_dataclasses_comes_back_exactly_equal():
    inner = body(key=None, last=None)
    value = body(pair=(Leg("in", np.ones(2)), inner))
    decoded = BODIES.decode(BODIES.encode(value))
    assert repr(decoded) == repr(value)
    assert type(decoded.last) is NoFix
    assert decoded.legs[0].gait is Gait.FAST
    assert type(decoded.pair[1]) is Body
    assert type(decoded.level) is np.float64


def test_arrays_keep_their_memory_order_and_protection():
    protected = np.ones(3)
    protected.flags.writeable = False
    value = body(legs=(*body().legs, Leg("p", protected)))
    for before, after in zip(value.legs, BODIES.decode(BODIES.encode(value)).legs, strict=True):
        assert after.samples.dtype == before.samples.dtype
        for flag in ("C_CONTIGUOUS", "F_CONTIGUOUS", "WRITEABLE"):
            assert after.samples.flags[flag] == before.samples.flags[flag]


def test_encoding_is_a_function_of_the_value():
    assert BODIES.encode(body()) == BODIES.encode(body())


@given(
    npst.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
        npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    )
)
def test_any_array_comes_back_byte_for_byte(array: np.ndarray):
    codec = TreeCodec(Leg)
    decoded = codec.decode(codec.encode(Leg("", array))).samples
    assert (decoded.dtype, decoded.shape) == (array.dtype, array.shape)
    assert decoded.tobytes() == array.tobytes()


def test_the_state_of_a_session_has_an_encoding():
    codec = TreeCodec(SessionState)
    decoded = codec.decode(codec.encode(SessionState()))
    assert repr(decoded) == repr(SessionState())
    assert codec.encode(decoded) == codec.encode(SessionState())


def test_a_radio_map_has_an_encoding():
    print_ = Fingerprint(0, 1.0, 2.0, {"mac:a": -60.0}, {"ibeacon:b": -70.5}, "walk 1")
    built = build_radio_map(("F1",), [print_, print_])
    codec = TreeCodec(RadioMap)
    decoded = codec.decode(codec.encode(built))
    assert repr(decoded) == repr(built)
    assert decoded.column_by_key == built.column_by_key


@pytest.mark.parametrize("changed", [("count", "int"), ("x_m", "float"), ("extra", "int")])
def test_a_tree_of_another_layout_is_refused(changed: tuple[str, str]):
    then = dataclasses.make_dataclass("Inner", [("count", int), ("x_m", float)], frozen=True)
    fields = {"count": int, "x_m": float, changed[0]: {"int": int, "float": str}[changed[1]]}
    now = dataclasses.make_dataclass("Inner", list(fields.items()), frozen=True)
    holders = [
        dataclasses.make_dataclass("Outer", [("inner", tuple[cls, ...])], frozen=True)
        for cls in (then, now)
    ]
    blob = TreeCodec(holders[0]).encode(holders[0]((then(1, 2.0),)))
    if fields == {"count": int, "x_m": float}:
        assert TreeCodec(holders[1]).decode(blob).inner[0].x_m == 2.0
    else:
        with pytest.raises(SchemaError, match="layout"):
            TreeCodec(holders[1]).decode(blob)


def test_bytes_of_another_schema_are_refused():
    with pytest.raises(SchemaError, match="schema"):
        OBSERVATIONS.decode(b"\x63" + OBSERVATIONS.encode([])[1:])
    with pytest.raises(SchemaError, match="layout"):
        BODIES.decode(b"")
    with pytest.raises(SchemaError):
        OBSERVATIONS.decode(OBSERVATIONS.encode([Barometer(1.0, 2.0)])[:-3])


@dataclass(frozen=True)
class Old:
    time_s: float


@dataclass(frozen=True)
class New:
    time_s: float
    note: str = "unknown"


def test_the_log_of_an_older_build_is_read_with_defaults_and_of_a_later_refused():
    old, new = VariantCodec({"event": Old}), VariantCodec({"event": New})
    assert new.decode(old.encode([Old(1.5)])) == (New(1.5),)
    with pytest.raises(SchemaError, match="fields"):
        old.decode(new.encode([New(1.5)]))
    with pytest.raises(SchemaError, match="kind"):
        VariantCodec({"other": New}).decode(new.encode([New(1.5)]))


@dataclass(frozen=True)
class Unstorable:
    items: list[int]


def test_types_without_a_lossless_encoding_are_refused_at_once():
    with pytest.raises(TypeError, match="lossless"):
        TreeCodec(Unstorable)
    with pytest.raises(TypeError, match="lossless"):
        TreeCodec(Leg).encode(Leg("", np.array([object()])))
