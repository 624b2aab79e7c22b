"""A beacon carried by a robot through a flat, heard by six fixed receivers (Kolakowski 2021).

Roles are reversed, the mobile transmits; geometry and level model are the same. Each row of a
recording has the time, the robot's true place and one level per receiver, empty where not heard.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from app.core.site import Wall
from app.core.types import Anchor, FloatArray

FLOOR = "flat"
CALIBRATION, ROBOT = "calibration.csv", "test_robot.csv"


@dataclass(frozen=True, slots=True, eq=False)
class RobotRecording:
    """What was heard along a drive.

    Attributes
    ----------
    time_s, x_m, y_m : (rows,)
        When, and where the robot truly was.
    rssi_dbm : (rows, anchors)
        Level at each receiver, nan where it heard nothing.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    rssi_dbm: FloatArray


def read_anchors(folder: Path) -> tuple[Anchor, ...]:
    """Read the receivers; ValueError if the table is not of this format."""
    try:
        return tuple(
            Anchor(
                anchor_id=row["anchor_id"],
                keys=(row["anchor_id"],),
                floor_id=FLOOR,
                x_m=float(row["x_m"]),
                y_m=float(row["y_m"]),
                z_m=float(row["z_m"]),
            )
            for row in _rows(folder / "anchors.csv")
        )
    except (KeyError, TypeError) as error:
        msg = f"{folder}: not the anchors of this data set ({error!r})"
        raise ValueError(msg) from error


def read_walls(folder: Path) -> tuple[Wall, ...]:
    """Read the faces of the walls; ValueError if the table is not of this format."""
    path = folder / "layout_walls.csv"
    try:
        corners = [(float(row["x"]), float(row["y"])) for row in _rows(path)]
    except (KeyError, TypeError) as error:
        msg = f"{path.name}: not walls of this data set ({error!r})"
        raise ValueError(msg) from error
    return tuple(Wall(*begin, *end) for begin, end in pairwise(corners))


def read_recording(path: Path, anchors: tuple[Anchor, ...]) -> RobotRecording:
    """Read a drive; ValueError if the table is not of this format."""
    columns = ["t_ms", "x_m", "y_m", *(f"rssi_{anchor.anchor_id}" for anchor in anchors)]
    try:
        rows = np.array([[float(row[c] or "nan") for c in columns] for row in _rows(path)])
    except (KeyError, TypeError) as error:
        msg = f"{path.name}: not a drive of this data set ({error!r})"
        raise ValueError(msg) from error
    rows = rows.reshape(-1, len(columns))
    return RobotRecording(rows[:, 0] / 1000.0, rows[:, 1], rows[:, 2], rows[:, 3:])


def _rows(path: Path) -> Iterator[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as table:
        yield from csv.DictReader(table)
