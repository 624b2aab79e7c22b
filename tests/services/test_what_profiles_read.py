"""A profile lists the parameters that its walks read, and no others."""

import dataclasses
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from app.core.engine import PROFILES, order_key, smoothed
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.geometry import Walkable
from app.core.params import Params
from app.core.site import Floor, SiteModel, Wall
from app.core.types import (
    Anchor,
    BleScan,
    FloatArray,
    ImuBlock,
    Observation,
    Reading,
    Steps,
    WifiScan,
)
from app.services.profiles import ParameterGroup, ProfileView, find_profile

CORNERS = ((2.0, 2.0), (38.0, 2.0), (38.0, 18.0), (2.0, 18.0), (2.0, 2.0))
BEACONS = tuple((float(x), float(y)) for x in (2, 14, 26, 38) for y in (2, 18))
PACE_MPS, REST_S, IMU_HZ, SCAN_HZ = 1.2, 6.0, 50.0, 2.0
REF_DBM, EXPONENT, NOISE_DB = -45.0, 2.2, 2.0
WIFI_UNTIL_S = 60.0

_COPIES = {dataclasses.__file__, "<string>"}
"""Code that copies, compares and hashes blocks: it takes every parameter, and uses none."""


def recording(block: Any, path: str, read: set[str]) -> Any:
    """Return the block as one that notes which of its parameters are read."""
    names = {field.name for field in dataclasses.fields(block)}

    def noted(self: object, name: str) -> object:
        value = object.__getattribute__(self, name)
        is_copied = sys._getframe(1).f_code.co_filename in _COPIES
        if name in names and not is_copied and not dataclasses.is_dataclass(value):
            read.add(path + name)
        return value

    kind = type(block)
    noting = type(kind.__name__, (kind,), {"__slots__": (), "__getattribute__": noted})
    values = {name: getattr(block, name) for name in names}
    for name, value in values.items():
        if dataclasses.is_dataclass(value):
            values[name] = recording(value, f"{path}{name}.", read)
    return noting(**values)


def place_at(time_s: float) -> tuple[float, float, float]:
    """Return x, y and heading on a round through the hall that rests at each of its corners."""
    for (x0, y0), (x1, y1) in pairwise(CORNERS):
        heading_rad, leg_s = math.atan2(y1 - y0, x1 - x0), math.dist((x0, y0), (x1, y1)) / PACE_MPS
        if time_s < REST_S + leg_s:
            share = max(time_s - REST_S, 0.0) / leg_s
            return x0 + share * (x1 - x0), y0 + share * (y1 - y0), heading_rad
        time_s -= REST_S + leg_s
    return *CORNERS[-1], 0.0


ROUND_S = math.ceil(4 * REST_S + 104.0 / PACE_MPS)
LATE_S = ROUND_S + 40.0


def levels_dbm(kind: str, x_m: float, y_m: float) -> dict[str, float]:
    every = {
        f"{kind}{i}": REF_DBM - 10.0 * EXPONENT * math.log10(max(math.hypot(x_m - x, y_m - y), 1.0))
        for i, (x, y) in enumerate(BEACONS)
    }
    return {key: level for key, level in every.items() if level > -75.0}


def sites() -> Iterator[SiteModel]:
    """Yield a hall with a column nobody walks through: with map and beacons, or without."""
    x, y = np.meshgrid(np.arange(0.25, 40.0, 0.5), np.arange(0.25, 20.0, 0.5))
    aisles = np.clip(np.minimum(np.minimum(x - 3.0, 37.0 - x), np.minimum(y - 3.0, 17.0 - y)), 0, 9)
    walls, walkable = (Wall(20.0, 5.0, 20.0, 15.0),), Walkable(0.25, 0.25, 0.5, aisles)
    floor = Floor("f", "Hall", "", 0, 0.0, 0.0, 40.0, 20.0, walkable, walls)
    model = {"ref_level_dbm": REF_DBM, "path_loss_exponent": EXPONENT, "shadowing_db": NOISE_DB}
    anchors = tuple(
        Anchor(f"a{i}", (f"b{i}",), "f", x, y, **model) for i, (x, y) in enumerate(BEACONS)
    )
    rows = [
        Fingerprint(0, x, y, levels_dbm("w", x, y), levels_dbm("b", x, y))
        for x in np.arange(1.0, 40.0, 2.0).tolist()
        for y in (2.0, 10.0, 18.0)
    ]
    whole = SiteModel("hall", 1, (floor,), anchors, build_radio_map(("f",), rows))
    yield whole
    yield replace(whole, anchors=())
    yield replace(whole, radio_map=None)
    yield replace(whole, anchors=(), radio_map=None)


def scans(rng: np.random.Generator) -> Iterator[Observation]:
    """Yield a round's scans: of both radios, of beacons alone, and at last of strangers."""
    for time_s in np.arange(0.0, ROUND_S, 1.0 / SCAN_HZ).tolist():
        x_m, y_m, _ = place_at(time_s)
        beacons = levels_dbm("b", x_m, y_m)
        yield BleScan(time_s, _heard(beacons, rng))
        if time_s < WIFI_UNTIL_S and time_s % 2.0 == 1.0:
            # The phone's first scan has lain about for a while.
            age_s = 5.0 if time_s == 1.0 else 0.0
            yield WifiScan(time_s, _heard(levels_dbm("w", x_m, y_m), rng, age_s))
    for time_s in np.arange(ROUND_S + 1.0, LATE_S, 2.0).tolist():
        yield WifiScan(time_s, tuple(Reading((f"x{i}",), -60.0) for i in range(9)))


def _heard(
    levels: dict[str, float], rng: np.random.Generator, age_s: float = 0.0
) -> tuple[Reading, ...]:
    noise_db = rng.normal(0.0, NOISE_DB, len(levels)).tolist()
    return tuple(
        Reading((key,), level + noise, age_s)
        for (key, level), noise in zip(levels.items(), noise_db, strict=True)
    )


def told_steps() -> Iterator[Observation]:
    """Yield the steps of a phone that counts them, with a length and without one."""
    for second in range(int(LATE_S)):
        before, after = place_at(second), place_at(second + 1.0)
        if before[:2] != after[:2] or second > ROUND_S:
            length_m = None if second % 10 == 0 else 0.6
            yield Steps(second + 1.0, 2, length_m, before[2])


def inertial_samples() -> Iterator[Observation]:
    count = int(IMU_HZ)
    swing = np.sin(2.0 * math.pi * 2.0 / IMU_HZ * np.arange(count))
    for second in range(ROUND_S):
        before, after = place_at(second), place_at(second + 1.0)
        gain_mps2 = 3.0 if before[:2] != after[:2] else 0.0
        up_mps2 = 9.81 + gain_mps2 * swing
        half_rad = 0.5 * (before[2] - math.pi / 2.0)
        yield ImuBlock(
            float(second),
            IMU_HZ,
            _rows(np.column_stack([np.zeros((count, 2)), up_mps2])),
            _rows(np.zeros((count, 3))),
            _rows(np.empty((0, 3))),
            _rows(np.tile([math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)], (count, 1))),
        )


def _rows(values: FloatArray) -> Any:
    return values.astype(np.float32)


def walks() -> Iterator[list[Observation]]:
    """Yield the round as phones post it that count steps, that have sensors, and that have none."""
    told = list(scans(np.random.default_rng(5)))
    for sensed in (told_steps(), inertial_samples(), ()):
        yield sorted([*told, *sensed], key=order_key)


def read_by_walks(params: Params) -> set[str]:
    """Return the parameters that are read while the walks are folded and smoothed."""
    read: set[str] = set()
    noting = recording(params, "", read)
    for site in sites():
        for walk in walks():
            smoothed(walk, site, noting)
    return read - {"profile"}


def listed(part: ProfileView | ParameterGroup, path: str = "") -> set[str]:
    names = {path + parameter.name for parameter in part.parameters}
    return names.union(*(listed(group, f"{path}{group.name}.") for group in part.groups))


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_profile_lists_what_its_walks_read(name: str) -> None:
    assert listed(find_profile(name)) == read_by_walks(PROFILES[name].params)


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_what_a_profile_says_it_reads_is_there(name: str) -> None:
    for path in PROFILES[name].reads:
        part: Any = PROFILES[name].params
        for step in path.split("."):
            part = getattr(part, step)


def test_every_parameter_is_listed_by_some_profile() -> None:
    every = set().union(*(listed(find_profile(name)) for name in PROFILES))
    block: Any
    for name, block in _blocks(Params()):
        assert {f"{name}.{field.name}" for field in dataclasses.fields(block)} <= every


def _blocks(params: Params) -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(params):
        value = getattr(params, field.name)
        if dataclasses.is_dataclass(value):
            yield field.name, value


def test_a_system_without_a_filter_lists_no_particles() -> None:
    groups = {group.name for group in find_profile("grinyak2018").groups}
    assert groups == {"floor", "lateration", "motion_mode", "report", "step"}
    assert "fusion.particles" in listed(find_profile("best"))
