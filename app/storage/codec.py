"""Lossless MessagePack of core's frozen dataclasses, driven by their type hints.

A dataclass is the array of its fields in order, an array keeps its dtype, shape, memory order and
bytes, a member of a union of dataclasses carries its class name. What was encoded decodes to
exactly equal values, floats bit for bit. `TreeCodec` is for one value whose layout changes with the
program (engine state): it refuses what another layout wrote. `VariantCodec` is for values that must
stay readable (the log): their classes may only get further fields with defaults, at the end.
"""

import dataclasses
import enum
import hashlib
import types
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import (
    Any,
    Generic,
    Literal,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
import numpy as np

T = TypeVar("T")
Hint: TypeAlias = Any
# A value on either side: a field's, or what MessagePack makes of it.
Value: TypeAlias = Any
Pack: TypeAlias = Callable[[Value], Value]

SCHEMA = 1
_ARRAY, _SCALAR = 1, 2
_LEAVES = (type(None), bool, int, float, str, bytes, np.ndarray)


class SchemaError(ValueError):
    """The bytes were written by a build with another layout, or are no such bytes at all."""


@dataclasses.dataclass(slots=True)
class _Layout:
    """How one type is packed; None where the value goes to MessagePack as it is.

    ``is_leaf`` is said, not found out: the layout of a class that contains itself is asked for
    before its functions are there.
    """

    outline: str
    pack: Pack | None = None
    unpack: Pack | None = None
    is_leaf: bool = False


class TreeCodec(Generic[T]):
    """Encode values of one dataclass; the bytes name the exact layout of its whole type tree."""

    def __init__(self, root: type[T]) -> None:
        layouts = _Layouts()
        self._layout = layouts.of(root)
        outline = "\n".join(layout.outline for layout in layouts.known.values())
        self._header = bytes([SCHEMA]) + hashlib.blake2b(outline.encode(), digest_size=8).digest()

    def encode(self, value: T) -> bytes:
        """Return the bytes of a value."""
        return self._header + _to_bytes(_pack(self._layout, value))

    def decode(self, blob: bytes) -> T:
        """Return the value of the bytes.

        Raises
        ------
        SchemaError
            If another layout wrote them.
        """
        size = len(self._header)
        if blob[:size] != self._header:
            msg = f"written with layout {blob[:size].hex()}, this build has {self._header.hex()}"
            raise SchemaError(msg)
        value: T = _unpack(self._layout, _from_bytes(blob[size:]))
        return value


class VariantCodec(Generic[T]):
    """Encode sequences of several dataclasses, each under a lasting kind word."""

    def __init__(self, kinds: dict[str, type[T]]) -> None:
        layouts = _Layouts()
        self._by_class = {cls: (kind, layouts.of(cls)) for kind, cls in kinds.items()}
        self._by_kind = {kind: layouts.of(cls) for kind, cls in kinds.items()}

    def encode(self, values: Sequence[T]) -> bytes:
        """Return the bytes of the values."""
        packed = []
        for value in values:
            kind, layout = self._by_class[type(value)]
            packed.append((kind, _pack(layout, value)))
        return bytes([SCHEMA]) + _to_bytes(packed)

    def decode(self, blob: bytes) -> tuple[T, ...]:
        """Return the values of the bytes.

        Raises
        ------
        SchemaError
            If a later build wrote them.
        """
        if blob[:1] != bytes([SCHEMA]):
            msg = f"written with schema {blob[:1].hex()}, this build reads {SCHEMA:02x}"
            raise SchemaError(msg)
        try:
            return tuple(_unpack(self._by_kind[kind], v) for kind, v in _from_bytes(blob[1:]))
        except KeyError as error:
            msg = f"unknown kind {error}"
            raise SchemaError(msg) from error


class _Layouts:
    """Builds the layouts of types, each dataclass once (so that one may contain itself)."""

    def __init__(self) -> None:
        self.known: dict[type, _Layout] = {}

    def of(self, hint: Hint) -> _Layout:
        """Return the layout of a type hint."""
        origin: Hint = get_origin(hint)
        arguments = get_args(hint)
        if hint in _LEAVES or origin in (np.ndarray, Literal):
            return _Layout(str(hint), is_leaf=True)
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            return self.known.get(hint) or self._dataclass(hint)
        if isinstance(hint, type) and issubclass(hint, enum.Enum):
            return _Layout(f"{hint.__name__}{[m.value for m in hint]}", attrgetter("value"), hint)
        if origin is tuple:
            return self._tuple(arguments)
        if origin in (Union, types.UnionType):
            return self._union(arguments)
        if origin is dict:
            return self._dict(*arguments)
        msg = f"{hint} has no lossless encoding"
        raise TypeError(msg)

    def _dataclass(self, cls: type) -> _Layout:
        layout = self.known[cls] = _Layout(cls.__name__)
        hints = get_type_hints(cls)
        fields = [field for field in dataclasses.fields(cls) if field.init]
        members = [self.of(hints[field.name]) for field in fields]
        names = [field.name for field in fields]
        if any(field.kw_only for field in fields):
            msg = f"{cls} has keyword-only fields"
            raise TypeError(msg)
        layout.outline += str([(n, m.outline) for n, m in zip(names, members, strict=True)])
        values_of = _fields_getter(names)
        packs = [(i, member) for i, member in enumerate(members) if not member.is_leaf]

        def pack(value: Value) -> Value:
            values = values_of(value)
            for i, member in packs:
                values[i] = _pack(member, values[i])
            return values

        def unpack(values: Value) -> Value:
            if len(values) > len(names):
                msg = f"{cls.__name__} with {len(values)} fields, this build knows {len(names)}"
                raise SchemaError(msg)
            for i, member in packs:
                if i < len(values):
                    values[i] = _unpack(member, values[i])
            return cls(*values)

        layout.pack, layout.unpack = pack, unpack
        return layout

    def _tuple(self, arguments: tuple[Hint, ...]) -> _Layout:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            item = self.of(arguments[0])
            if item.is_leaf:
                return _Layout(f"({item.outline}...)", None, tuple)
            return _Layout(
                f"({item.outline}...)",
                lambda values: [_pack(item, value) for value in values],
                lambda values: tuple([_unpack(item, value) for value in values]),
            )
        items = [self.of(argument) for argument in arguments]
        return _Layout(
            str([item.outline for item in items]),
            lambda values: [_pack(i, v) for i, v in zip(items, values, strict=True)],
            lambda values: tuple([_unpack(i, v) for i, v in zip(items, values, strict=True)]),
        )

    def _dict(self, key_hint: Hint, value_hint: Hint) -> _Layout:
        key, value = self.of(key_hint), self.of(value_hint)
        # Pairs, not a map: MessagePack's maps would lose tuples as keys.
        return _Layout(
            f"{{{key.outline}:{value.outline}}}",
            lambda d: [(_pack(key, k), _pack(value, v)) for k, v in d.items()],
            lambda pairs: {_unpack(key, k): _unpack(value, v) for k, v in pairs},
        )

    def _union(self, arguments: tuple[Hint, ...]) -> _Layout:
        members = {argument: self.of(argument) for argument in arguments}
        outline = "|".join(layout.outline for layout in members.values())
        if all(layout.is_leaf for layout in members.values()):
            return _Layout(outline, is_leaf=True)
        others = [argument for argument in arguments if argument is not type(None)]
        if len(others) == 1:
            only = members[others[0]]
            return _Layout(
                outline,
                lambda value: None if value is None else _pack(only, value),
                lambda packed: None if packed is None else _unpack(only, packed),
            )
        return _tagged(outline, {_class_of(a): layout for a, layout in members.items()})


def _tagged(outline: str, members: dict[type, _Layout]) -> _Layout:
    by_name = {cls.__name__: layout for cls, layout in members.items()}
    return _Layout(
        outline,
        lambda value: (type(value).__name__, _pack(members[type(value)], value)),
        lambda packed: _unpack(by_name[packed[0]], packed[1]),
    )


def _class_of(hint: Hint) -> type:
    origin: Hint = get_origin(hint)
    cls: type = hint if origin is None else origin
    return cls


def _fields_getter(names: list[str]) -> Callable[[Value], list[Value]]:
    if len(names) < 2:
        return lambda value: [getattr(value, name) for name in names]
    getter = attrgetter(*names)
    return lambda value: list(getter(value))


def _pack(layout: _Layout, value: Value) -> Value:
    return value if layout.pack is None else layout.pack(value)


def _unpack(layout: _Layout, packed: Value) -> Value:
    return packed if layout.unpack is None else layout.unpack(packed)


def _to_bytes(packed: Value) -> bytes:
    return msgspec.msgpack.encode(packed, enc_hook=_numpy_to_ext)


def _from_bytes(blob: bytes) -> Value:
    try:
        return msgspec.msgpack.decode(blob, ext_hook=_ext_to_numpy)
    except msgspec.DecodeError as error:
        raise SchemaError(str(error)) from error


def _numpy_to_ext(value: object) -> msgspec.msgpack.Ext:
    if isinstance(value, np.generic):
        return msgspec.msgpack.Ext(_SCALAR, _array_bytes(np.asarray(value)))
    if isinstance(value, np.ndarray):
        return msgspec.msgpack.Ext(_ARRAY, _array_bytes(value))
    msg = f"{type(value)} has no lossless encoding"
    raise TypeError(msg)


def _array_bytes(array: np.ndarray[Any, Any]) -> bytes:
    if array.dtype.hasobject or array.dtype.fields:
        msg = f"arrays of {array.dtype} have no lossless encoding"
        raise TypeError(msg)
    # Memory order is kept: sums over an array may differ in the last bit between the two.
    order: Literal["C", "F"] = "F" if array.flags.fnc else "C"
    head = (array.dtype.str, array.shape, order, array.flags.writeable, array.tobytes(order))
    return msgspec.msgpack.encode(head)


def _ext_to_numpy(code: int, body: memoryview) -> Value:
    dtype, shape, order, writeable, samples = msgspec.msgpack.decode(body)
    array = np.frombuffer(samples, dtype=dtype).reshape(shape, order=order)
    if code == _SCALAR:
        return array[()]
    if writeable:
        return array.copy(order=order)
    return array
