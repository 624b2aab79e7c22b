"""BLE scans at known points (UJI BLE RSS database): anchors, samples and their levels, three CSVs.

A sample is one scan at a point; each point was scanned several times with every setting of the
transmit power and every phone.
"""

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from app.core.site import Wall
from app.core.types import Anchor

FLOOR = "floor"


@dataclass(frozen=True, slots=True)
class LevelAt:
    """One reading: which anchor, when (phone clock), how loud."""

    anchor_id: str
    time_s: float
    rssi_dbm: float


@dataclass(frozen=True, slots=True)
class PointScan:
    """One scan, and where it was made."""

    phone: str
    tx_power_dbm: int
    campaign: str
    point: int
    x_m: float
    y_m: float
    levels: tuple[LevelAt, ...]


def read_zone(folder: Path, zone: str) -> tuple[tuple[Anchor, ...], list[PointScan]]:
    """Read the anchors and the scans of one zone.

    Raises
    ------
    ValueError
        If a table is not of this format, or the zone is not in it.
    """
    try:
        anchors = tuple(
            Anchor(
                row["anchor_id"], (row["anchor_id"],), FLOOR, float(row["x_m"]), float(row["y_m"])
            )
            for row in _rows(folder / "anchors.csv")
            if row["zone"] == zone
        )
        levels: dict[str, list[LevelAt]] = defaultdict(list)
        for row in _rows(folder / "rssi.csv"):
            heard = LevelAt(row["anchor_id"], int(row["t_ns"]) / 1e9, float(row["rssi_dbm"]))
            levels[row["sample_id"]].append(heard)
        scans = [
            _scan(row, tuple(levels[row["sample_id"]]))
            for row in _rows(folder / "samples.csv")
            if row["zone"] == zone
        ]
    except (KeyError, TypeError) as error:
        msg = f"{folder}: not tables of the UJI BLE database ({error!r})"
        raise ValueError(msg) from error
    if not anchors or not scans:
        msg = f"{folder}: no zone {zone!r} in it"
        raise ValueError(msg)
    return anchors, scans


def read_obstacles(folder: Path, zone: str) -> tuple[Wall, ...]:
    """Read the sides of the shelves and pillars of one zone; none where their table is missing.

    Raises
    ------
    ValueError
        If the table is not of this format.
    """
    path = folder / f"obstacles_{zone}.csv"
    if not path.exists():
        return ()
    try:
        corners = [(row["id"], float(row["x"]), float(row["y"])) for row in _rows(path)]
    except (KeyError, TypeError) as error:
        msg = f"{path.name}: not obstacles of the UJI BLE database ({error!r})"
        raise ValueError(msg) from error
    return tuple(
        Wall(x0_m, y0_m, x1_m, y1_m)
        for (one, x0_m, y0_m), (other, x1_m, y1_m) in pairwise(corners)
        if one == other
    )


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as table:
        yield from csv.DictReader(table)


def _scan(row: dict[str, str], levels: tuple[LevelAt, ...]) -> PointScan:
    return PointScan(
        phone=row["phone"],
        tx_power_dbm=int(row["tx_power_dbm"]),
        campaign=row["campaign"],
        point=int(row["point"]),
        x_m=float(row["x_m"]),
        y_m=float(row["y_m"]),
        levels=levels,
    )
