"""Wi-Fi fingerprints of three university buildings (UJIIndoorLoc): one scan a row.

Columns ``WAP001`` on hold levels in dBm, 100 where the access point was not heard; then longitude
and latitude, which are metres of a map projection, floor, building, and who scanned with what.
"""

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.core.types import FloatArray

TRAINING, VALIDATION = "trainingData.csv.gz", "validationData.csv.gz"
NOT_HEARD = 100


@dataclass(frozen=True, slots=True, eq=False)
class LabelledScan:
    """One scan and where it was made; ``floor`` is named by building and floor."""

    floor: str
    x_m: float
    y_m: float
    rssi_dbm: dict[str, float]


def read_scans(path: Path) -> list[LabelledScan]:
    """Read one of the two tables.

    Raises
    ------
    ValueError
        If the file is not of this format; the message names it.
    """
    try:
        with gzip.open(path, "rt", encoding="ascii") as lines:
            names = lines.readline().strip().split(",")
            rows = np.loadtxt(lines, delimiter=",", ndmin=2)
        return list(_scans(names, rows))
    except (OSError, EOFError, ValueError) as error:
        msg = f"{path.name}: not a table of UJIIndoorLoc ({error})"
        raise ValueError(msg) from error


def _scans(names: list[str], rows: FloatArray) -> Iterator[LabelledScan]:
    x, y, floor, building = (
        rows[:, names.index(name)] for name in ("LONGITUDE", "LATITUDE", "FLOOR", "BUILDINGID")
    )
    access_points = [i for i, name in enumerate(names) if name.startswith("WAP")]
    keys = [names[i] for i in access_points]
    levels = rows[:, access_points]
    for i, row in enumerate(levels):
        heard = np.flatnonzero(row != NOT_HEARD)
        yield LabelledScan(
            floor=f"{building[i]:.0f}-{floor[i]:.0f}",
            x_m=float(x[i]),
            y_m=float(y[i]),
            rssi_dbm={keys[j]: float(row[j]) for j in heard},
        )
