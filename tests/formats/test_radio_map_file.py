"""A radio map goes through its file untouched, and nothing else goes in."""

import io
import json
import pickle
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.core.fingerprint.cleaning import LevelStatistics
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.formats.radio_map_file import (
    COLUMNS,
    MANIFEST,
    MAX_MANIFEST_BYTES,
    STATISTICS,
    RadioMapFile,
    RadioMapFileError,
    read_radio_map,
    write_radio_map,
)

Members = dict[str, bytes]


def radio_map() -> RadioMap:
    rows = [
        Fingerprint(0, 1.1, -2.0, {"mac:000000000001": -60.25}, {"mac:00000000000b": -71.0}, "a"),
        Fingerprint(1, 1e-9, 3.0, {"mac:000000000002": -1 / 3 - 50}, {}, "b"),
        Fingerprint(1, 4.0, 3.0, {"mac:000000000001": -90.0}, {}, "a"),
    ]
    return build_radio_map(("f0", "f1", "empty"), rows)


def content() -> RadioMapFile:
    statistics = LevelStatistics(
        np.array([0.5, 0.0, 1.0, 2.0]), np.array([5, 1, 1, 9]), np.array([1.0, 0.2, 1.0, 0.9])
    )
    return RadioMapFile("Größe", radio_map(), statistics, {"surveys": ["s1"]})


def members(raw: bytes) -> Members:
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(of: Members) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, body in of.items():
            archive.writestr(name, body)
    return out.getvalue()


def npy(values: Any, **options: Any) -> bytes:
    out = io.BytesIO()
    np.save(out, np.asarray(values), **options)
    return out.getvalue()


def test_every_bit_of_a_map_comes_back() -> None:
    back = read_radio_map(write_radio_map(content()))
    assert (back.name, back.provenance) == ("Größe", {"surveys": ["s1"]})
    expected = radio_map()
    for name in ("floor_ids", "survey_walks", "transmitters"):
        assert getattr(back.radio_map, name) == getattr(expected, name)
    for name in ("floor_index", "x_m", "y_m", "radio", "row_start", "column", "rssi_dbm"):
        mine, theirs = getattr(back.radio_map, name), getattr(expected, name)
        assert (mine.dtype, mine.tobytes()) == (theirs.dtype, theirs.tobytes())
    assert back.statistics is not None
    for name in STATISTICS:
        assert (
            getattr(back.statistics, name).tolist() == getattr(content().statistics, name).tolist()
        )


def test_a_map_without_scatter_has_none_and_equal_maps_make_equal_files() -> None:
    plain = replace(content(), statistics=None)
    assert read_radio_map(write_radio_map(plain)).statistics is None
    assert write_radio_map(plain) == write_radio_map(replace(content(), statistics=None))


def test_the_arrays_are_what_numpy_reads() -> None:
    of = members(write_radio_map(content()))
    assert set(of) == {MANIFEST, *(f"{name}.npy" for name in (*COLUMNS, *STATISTICS))}
    levels = np.load(io.BytesIO(of["rssi_dbm.npy"]), allow_pickle=False)
    assert levels.tolist() == radio_map().rssi_dbm.tolist()


def manifest(**changed: Any) -> Callable[[Members], None]:
    def change(of: Members) -> None:
        of[MANIFEST] = json.dumps(json.loads(of[MANIFEST]) | changed).encode()

    return change


def array(name: str, values: Any, **options: Any) -> Callable[[Members], None]:
    def change(of: Members) -> None:
        of[f"{name}.npy"] = npy(values, **options)

    return change


def lying_about_its_length(of: Members) -> None:
    of["x_m.npy"] = of["x_m.npy"].replace(b"(3,)", b"(9999999999,)")


def with_a_stranger(of: Members) -> None:
    of["../../etc/cron.d/evil"] = b"x"


def without_an_array(of: Members) -> None:
    del of["walk.npy"]


def with_half_of_the_scatter(of: Members) -> None:
    del of["count.npy"]


def with_a_pickle(of: Members) -> None:
    of["x_m.npy"] = pickle.dumps([1.0, 2.0, 3.0])


def with_a_bomb(of: Members) -> None:
    of[MANIFEST] = b" " * (MAX_MANIFEST_BYTES + 1)


REFUSED: dict[str, tuple[Callable[[Members], None], str]] = {
    "stranger": (with_a_stranger, "members"),
    "missing": (without_an_array, "members"),
    "half the scatter": (with_half_of_the_scatter, "members"),
    "pickle": (with_a_pickle, "not a NumPy array"),
    "object array": (array("x_m", np.array([{}, {}, {}], dtype=object)), "one row of"),
    "bomb": (with_a_bomb, "larger"),
    "lying length": (lying_about_its_length, "x_m.npy"),
    "wrong type": (array("x_m", np.zeros(3, dtype=np.float32)), "one row of"),
    "two dimensions": (array("x_m", np.zeros((3, 1))), "one row of"),
    "too short": (array("x_m", np.zeros(2)), "lengths"),
    "nan place": (array("x_m", np.array([1.0, np.nan, 2.0])), "metres"),
    "far place": (array("y_m", np.array([1.0, 1e9, 2.0])), "metres"),
    "loud level": (array("rssi_dbm", np.array([-60.0, 99.0, -60.0, -60.0])), "level"),
    "no such floor": (array("floor", np.array([0, 1, 3], dtype=np.int32)), "floor"),
    "negative column": (array("column", np.array([0, 1, -1, 0], dtype=np.int32)), "column"),
    "no such walk": (array("walk", np.array([0, 1, 2], dtype=np.int32)), "walk"),
    "third radio": (array("radio", np.array([0, 1, 2], dtype=np.uint8)), "radio"),
    "row_start": (array("row_start", np.array([0, 3, 2, 4])), "row_start"),
    "twice in a row": (array("column", np.array([0, 0, 2, 0], dtype=np.int32)), "twice"),
    "bad share": (array("heard_share", np.array([1.0, 1.0, 1.0, 1.5])), "heard_share"),
    "negative count": (array("count", np.array([1, 1, 1, -1], dtype=np.int32)), "count"),
    "other version": (manifest(version=2), "2"),
    "other format": (manifest(format="npz"), "npz"),
    "unknown field": (manifest(run="rm -rf"), "run"),
    "wrong field": (manifest(floor_ids="f0"), "floor_ids"),
    "key twice": (manifest(transmitters=["mac:000000000001"] * 3), "twice"),
    "no such key": (manifest(transmitters=["=cmd()", "mac:000000000002", "mac:000000000003"]), "="),
    "other spelling": (
        manifest(transmitters=["mac:00:00:00:00:00:0A", "mac:000000000002", "mac:000000000003"]),
        "canonical",
    ),
    "control characters": (manifest(name="a\x1b[2J"), "control"),
}


@pytest.mark.parametrize(("change", "words"), REFUSED.values(), ids=REFUSED)
def test_a_hostile_file_is_refused_in_words(change: Callable[[Members], None], words: str) -> None:
    of = members(write_radio_map(content()))
    change(of)
    with pytest.raises(RadioMapFileError, match=re.escape(words)):
        read_radio_map(packed(of))


def test_cut_off_and_damaged_files_are_refused() -> None:
    raw = write_radio_map(content())
    rng = np.random.default_rng(1)
    for length in (0, 1, 10, len(raw) // 2, len(raw) - 1):
        with pytest.raises(RadioMapFileError):
            read_radio_map(raw[:length])
    for _ in range(200):
        damaged = bytearray(raw)
        damaged[int(rng.integers(len(raw)))] ^= int(rng.integers(1, 256))
        try:
            read_radio_map(bytes(damaged))
        except RadioMapFileError:
            continue
