"""A radio map as one file: a ZIP archive of one JSON document and one NumPy array per column.

docs/formats.md has the layout. A file is taken only if it is exactly that: known members of the
types and lengths that the document announces, nothing pickled, nothing larger than its bounds, and
every number one that a radio map can hold. Members are looked up by name and never written to disk.
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.lib import format as npy

from app.core.fingerprint.cleaning import LevelStatistics
from app.core.fingerprint.radio_map import BLE, WIFI, RadioMap
from app.core.types import FloatArray, IntArray
from app.formats.transmitters import canonical_key

FORMAT, VERSION = "pharos-radio-map", 1
MANIFEST = "radio_map.json"

COLUMNS: dict[str, str] = {
    "floor": "<i4",
    "x_m": "<f8",
    "y_m": "<f8",
    "walk": "<i4",
    "radio": "|u1",
    "row_start": "<i8",
    "column": "<i4",
    "rssi_dbm": "<f8",
}
"""Arrays that every file holds, with their types."""

STATISTICS: dict[str, str] = {"deviation_db": "<f8", "count": "<i4", "heard_share": "<f8"}
"""Arrays, one number per level, that a map of cleaned reference points holds too."""

MAX_FILE_BYTES = 256 << 20
MAX_MANIFEST_BYTES = 64 << 20
MAX_ROWS, MAX_TRANSMITTERS, MAX_LEVELS, MAX_FLOORS = 1_000_000, 500_000, 20_000_000, 1_000
"""Two orders of magnitude beyond a shopping centre (10 000 rows, 5 000 transmitters)."""

_MAX_NAME = 200
_MAX_M = 1_000_000.0
_MIN_DBM, _MAX_DBM = -200.0, 20.0
_NPY_HEADER_BYTES = 1_024


# What zipfile answers to damaged offsets, lengths, streams, flags and names, one each.
_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)


class RadioMapFileError(ValueError):
    """The file is not a radio map; the words say what is wrong with it."""


@dataclass(frozen=True, slots=True, eq=False)
class RadioMapFile:
    """What a file holds.

    Attributes
    ----------
    statistics
        Of each level of ``radio_map``; None for a map without cleaned reference points.
    provenance
        Where the map came from, as JSON.
    """

    name: str
    radio_map: RadioMap
    statistics: LevelStatistics | None = None
    provenance: dict[str, Any] | None = None


class _Manifest(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    name: str
    floor_ids: list[str]
    walks: list[str]
    transmitters: list[str]
    provenance: dict[str, Any] | None = None


def write_radio_map(content: RadioMapFile) -> bytes:
    """Return the bytes of a file; equal maps make equal bytes."""
    radio_map = content.radio_map
    walks = sorted(set(radio_map.survey_walks))
    number = {walk: i for i, walk in enumerate(walks)}
    arrays: dict[str, Any] = {
        "floor": radio_map.floor_index,
        "x_m": radio_map.x_m,
        "y_m": radio_map.y_m,
        "walk": np.array([number[walk] for walk in radio_map.survey_walks], dtype=np.int64),
        "radio": radio_map.radio,
        "row_start": radio_map.row_start,
        "column": radio_map.column,
        "rssi_dbm": radio_map.rssi_dbm,
    }
    if content.statistics is not None:
        arrays |= {name: getattr(content.statistics, name) for name in STATISTICS}
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "name": content.name,
        "floor_ids": radio_map.floor_ids,
        "walks": walks,
        "transmitters": radio_map.transmitters,
        "provenance": content.provenance,
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        text = json.dumps(manifest, ensure_ascii=False, indent=1)
        archive.writestr(_member(MANIFEST), text.encode())
        for name, values in arrays.items():
            body = io.BytesIO()
            typed = np.ascontiguousarray(values, dtype=(COLUMNS | STATISTICS)[name])
            npy.write_array(body, typed, version=(1, 0), allow_pickle=False)
            archive.writestr(_member(f"{name}.npy"), body.getvalue())
    return out.getvalue()


def _member(name: str) -> zipfile.ZipInfo:
    # A fixed time: the bytes say what is in the map, not when it was written.
    member = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    member.compress_type = zipfile.ZIP_DEFLATED
    return member


def read_radio_map(raw: bytes) -> RadioMapFile:
    """Read a file.

    Raises
    ------
    RadioMapFileError
        If it is not a radio map, is damaged, or is larger than the bounds above.
    """
    if len(raw) > MAX_FILE_BYTES:
        msg = f"a radio map has at most {MAX_FILE_BYTES >> 20} MB"
        raise RadioMapFileError(msg)
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            return _read(archive)
    except RadioMapFileError:
        raise
    except _DAMAGED as error:
        msg = f"not a complete ZIP archive: {error}"
        raise RadioMapFileError(msg) from error


def _read(archive: zipfile.ZipFile) -> RadioMapFile:
    names = archive.namelist()
    needed = {MANIFEST, *(f"{name}.npy" for name in COLUMNS)}
    statistics = {f"{name}.npy" for name in STATISTICS}
    if len(set(names)) != len(names) or set(names) not in (needed, needed | statistics):
        wrong = sorted(set(names) ^ needed)[:3]
        msg = f"its members are not those of a radio map: {', '.join(map(repr, wrong))}"
        raise RadioMapFileError(msg)
    manifest = _manifest(_member_bytes(archive, MANIFEST, MAX_MANIFEST_BYTES))
    arrays = {
        name: _array(archive, name, _longest(name))
        for name in (*COLUMNS, *(STATISTICS if len(names) > len(needed) else ()))
    }
    radio_map = _radio_map(manifest, arrays)
    return RadioMapFile(
        manifest.name, radio_map, _statistics(arrays, len(radio_map.column)), manifest.provenance
    )


def _member_bytes(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    with archive.open(name) as member:
        body = member.read(most + 1)
    if len(body) > most:
        msg = f"{name} is larger than a radio map can need"
        raise RadioMapFileError(msg)
    return body


def _longest(name: str) -> int:
    if name == "radio":
        return MAX_TRANSMITTERS
    if name in {"column", "rssi_dbm", *STATISTICS}:
        return MAX_LEVELS
    return MAX_ROWS + 1


def _array(archive: zipfile.ZipFile, name: str, longest: int) -> np.ndarray[Any, Any]:
    """Return a member's array; its header must be the plain one that `write_radio_map` makes."""
    dtype = np.dtype((COLUMNS | STATISTICS)[name])
    body = _member_bytes(archive, f"{name}.npy", longest * dtype.itemsize + _NPY_HEADER_BYTES)
    stream = io.BytesIO(body)
    try:
        if npy.read_magic(stream) != (1, 0):
            msg = f"{name}.npy is not of NumPy format 1.0"
            raise RadioMapFileError(msg)
        shape, by_column, found = npy.read_array_header_1_0(stream, _NPY_HEADER_BYTES)
    except ValueError as error:
        msg = f"{name}.npy is not a NumPy array"
        raise RadioMapFileError(msg) from error
    rest = body[stream.tell() :]
    is_plain = len(shape) == 1 and not by_column and found == dtype
    if not is_plain or len(rest) != shape[0] * dtype.itemsize:
        msg = f"{name}.npy is not one row of {dtype.str}"
        raise RadioMapFileError(msg)
    return np.frombuffer(rest, dtype=dtype)


def _manifest(body: bytes) -> _Manifest:
    try:
        manifest = msgspec.json.decode(body, type=_Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        msg = f"{MANIFEST}: {error}"
        raise RadioMapFileError(msg) from error
    if (manifest.format, manifest.version) != (FORMAT, VERSION):
        msg = f"{MANIFEST} is of {manifest.format!r} {manifest.version}, not {FORMAT!r} {VERSION}"
        raise RadioMapFileError(msg)
    named = [manifest.name, *manifest.floor_ids, *manifest.walks]
    if any(len(name) > _MAX_NAME or not name.isprintable() for name in named):
        msg = f"{MANIFEST}: a name is longer than {_MAX_NAME} or holds control characters"
        raise RadioMapFileError(msg)
    for what in (manifest.floor_ids, manifest.walks, manifest.transmitters):
        _need(len(set(what)) == len(what), f"{MANIFEST} names something twice")
    _need(len(manifest.floor_ids) <= MAX_FLOORS, f"more than {MAX_FLOORS} floors")
    for key in manifest.transmitters:
        _check_key(key)
    return manifest


def _check_key(key: str) -> None:
    try:
        is_canonical = canonical_key(key) == key
    except ValueError as error:
        raise RadioMapFileError(str(error)) from error
    _need(is_canonical, f"{key!r} is not in its canonical spelling")


def _radio_map(manifest: _Manifest, arrays: Mapping[str, np.ndarray[Any, Any]]) -> RadioMap:
    rows, levels = len(arrays["x_m"]), len(arrays["column"])
    columns = len(manifest.transmitters)
    lengths = {name: len(values) for name, values in arrays.items()}
    expected = dict.fromkeys(("floor", "x_m", "y_m", "walk"), rows)
    expected |= {"radio": columns, "row_start": rows + 1, "rssi_dbm": levels}
    _need(rows > 0, "it has no fingerprint")
    wrong = [name for name, length in expected.items() if lengths[name] != length]
    _need(not wrong, f"the lengths of {', '.join(wrong)} do not fit the others")
    for name, bound in (
        ("floor", len(manifest.floor_ids)),
        ("walk", len(manifest.walks)),
        ("column", columns),
    ):
        _need(_within(arrays[name], 0, bound - 1), f"{name} points to nothing")
    _need(bool(np.isin(arrays["radio"], (WIFI, BLE)).all()), "radio is neither 0 nor 1")
    start = arrays["row_start"]
    is_ascending = start[0] == 0 and start[-1] == levels and bool((np.diff(start) >= 0).all())
    _need(bool(is_ascending), "row_start is not ascending from 0 to the number of levels")
    for name in ("x_m", "y_m"):
        _need(_within(arrays[name], -_MAX_M, _MAX_M), f"{name} is not in metres of a site")
    _need(_within(arrays["rssi_dbm"], _MIN_DBM, _MAX_DBM), "rssi_dbm is not a level")
    row = np.repeat(np.arange(rows), np.diff(start))
    pairs = row * np.int64(max(columns, 1)) + arrays["column"]
    _need(len(np.unique(pairs)) == levels, "a fingerprint holds a transmitter twice")
    return RadioMap(
        floor_ids=tuple(manifest.floor_ids),
        floor_index=_ints(arrays["floor"]),
        x_m=_floats(arrays["x_m"]),
        y_m=_floats(arrays["y_m"]),
        survey_walks=tuple(manifest.walks[i] for i in arrays["walk"].tolist()),
        transmitters=tuple(manifest.transmitters),
        radio=_ints(arrays["radio"]),
        row_start=_ints(start),
        column=_ints(arrays["column"]),
        rssi_dbm=_floats(arrays["rssi_dbm"]),
    )


def _statistics(arrays: Mapping[str, np.ndarray[Any, Any]], levels: int) -> LevelStatistics | None:
    if "count" not in arrays:
        return None
    for name in STATISTICS:
        _need(len(arrays[name]) == levels, f"the length of {name} does not fit the levels")
    _need(_within(arrays["deviation_db"], 0.0, 200.0), "deviation_db is not a deviation")
    _need(_within(arrays["count"], 0, 2**31 - 1), "count is not a number of levels")
    _need(_within(arrays["heard_share"], 0.0, 1.0), "heard_share is not a share")
    return LevelStatistics(
        _floats(arrays["deviation_db"]), _ints(arrays["count"]), _floats(arrays["heard_share"])
    )


def _within(values: np.ndarray[Any, Any], low: float, high: float) -> bool:
    """Tell whether all numbers are in bounds; nan is in none."""
    return not len(values) or bool(low <= values.min() and values.max() <= high)


def _need(holds: bool, otherwise: str) -> None:
    if not holds:
        raise RadioMapFileError(otherwise)


def _ints(values: np.ndarray[Any, Any]) -> IntArray:
    return values.astype(np.int64)


def _floats(values: np.ndarray[Any, Any]) -> FloatArray:
    return values.astype(np.float64)
