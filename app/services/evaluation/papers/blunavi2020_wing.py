"""The wing of blunavi2020, simulated: rooms on both sides of a corridor, and what is heard there.

The paper's measurements are not public; this is its set-up with usual physics. A corridor of 48 m
by 3 m with eight rooms of 6 m by 6 m on either side, so 16 + 64 cells of 3 m. Access points hang in
corridor and rooms, three beacons on the corridor's wall. A level is

    u = u* - 10 n log10(d) - walls - body + s(place) + fading

with ``s`` a random field per transmitter (deviation 4.11 dB, correlated over metres: it stays where
it is), walls of 6 dB each, and the walker's own body before the transmitters behind him.
"""

import math
from dataclasses import dataclass

import numpy as np

from app.core.types import Anchor, BoolArray, FloatArray

CELL_M, LENGTH_M, WIDTH_M, ROOM_M = 3.0, 48.0, 3.0, 6.0
ROOMS = int(LENGTH_M / ROOM_M)
WALL_DB = 6.0
SHADOWING_DB = 4.11
"""The paper's sigma."""
CORRELATION_M = 3.0
FEATURES = 48
FADING_DB = 3.0
BODY_DB = 6.0
"""Loss through a body at 2.4 GHz: 5 to 10 dB."""
SENSITIVITY_DBM = -92.0
BEACONS = tuple(
    Anchor(f"b{i}", (f"b:{i}",), "wing", x, WIDTH_M, 1.5, -62.0, 1.0, 2.0, SHADOWING_DB)
    for i, x in enumerate((6.0, 24.0, 42.0))
)
"""On one wall of the corridor, 1.5 m over the phone, calibrated in line of sight."""
ACCESS_POINTS = np.array(
    [(x, 1.5) for x in (6.0, 18.0, 30.0, 42.0)]
    + [(3.0 + 12.0 * i, 8.0) for i in range(4)]
    + [(9.0 + 12.0 * i, -5.0) for i in range(4)]
    + [(-15.0, 2.0), (63.0, 2.0), (24.0, 25.0), (24.0, -22.0)]
)
"""Four in the corridor, four in rooms of either side, and one of every building around."""
BANDS = 2
"""Each is heard as two: 2.4 and 5 GHz have addresses, and shadowing, of their own."""


@dataclass(frozen=True, slots=True, eq=False)
class Radio:
    """Transmitters at ``places`` (n, 2) with their shadowing fields, drawn once per seed."""

    places: FloatArray
    height_m: float
    ref_level_dbm: float
    exponent: float
    frequency: FloatArray
    phase: FloatArray

    def levels_dbm(self, points: FloatArray) -> FloatArray:
        """Return mean levels (points, n) at points (points, 2), without body and fading."""
        away = points[:, None] - self.places[None]
        distance_m = np.sqrt((away**2).sum(axis=2) + self.height_m**2)
        angle = np.einsum("pd,nfd->pnf", points, self.frequency) + self.phase
        field_db = SHADOWING_DB * math.sqrt(2.0 / FEATURES) * np.cos(angle).sum(axis=2)
        loss_db = 10.0 * self.exponent * np.log10(np.maximum(distance_m, 0.3))
        loss_db = loss_db + WALL_DB * walls(points, self.places)
        return np.asarray(self.ref_level_dbm - loss_db + field_db)

    def heard_dbm(
        self, points: FloatArray, heading_rad: FloatArray, rng: np.random.Generator
    ) -> FloatArray:
        """Return what a walker hears (points, n); nan where it is too quiet."""
        toward = self.places[None] - points[:, None]
        ahead = np.column_stack([np.cos(heading_rad), np.sin(heading_rad)])
        behind = np.einsum("pnd,pd->pn", toward, ahead) < 0.0
        level = self.levels_dbm(points) - BODY_DB * behind
        level = level + FADING_DB * rng.normal(size=level.shape)
        return np.where(level >= SENSITIVITY_DBM, np.round(level), np.nan)


def access_points(rng: np.random.Generator) -> Radio:
    """Return the wing's Wi-Fi."""
    return _radio(np.repeat(ACCESS_POINTS, BANDS, axis=0), (1.5, -38.0, 2.6), rng)


def beacons(rng: np.random.Generator) -> Radio:
    """Return the wing's beacons, as their calibration says."""
    places = np.array([(b.x_m, b.y_m) for b in BEACONS])
    first = BEACONS[0]
    return _radio(places, (first.z_m, first.ref_level_dbm, first.path_loss_exponent), rng)


def _radio(
    places: FloatArray, model: tuple[float, float, float], rng: np.random.Generator
) -> Radio:
    frequency = rng.normal(size=(len(places), FEATURES, 2)) / CORRELATION_M
    phase = rng.uniform(0.0, 2.0 * math.pi, (len(places), FEATURES))
    return Radio(places, *model, frequency, phase)


def walls(points: FloatArray, places: FloatArray) -> FloatArray:
    """Return how many walls lie between points (p, 2) and places (n, 2): (p, n)."""
    y0, y1 = points[:, None, 1], places[None, :, 1]
    count = np.zeros((len(points), len(places)))
    for wall_m in (-ROOM_M, 0.0, WIDTH_M, WIDTH_M + ROOM_M):
        count += (y0 - wall_m) * (y1 - wall_m) < 0.0
    x0, x1 = points[:, None, 0], places[None, :, 0]
    for i in range(1, ROOMS):
        apart = np.where(x1 == x0, np.inf, x1 - x0)
        share = (ROOM_M * i - x0) / apart
        y = y0 + share * (y1 - y0)
        inside = (share > 0.0) & (share < 1.0) & ~in_corridor_y(y)
        count += inside & (y > -ROOM_M) & (y < WIDTH_M + ROOM_M)
    return count


def in_corridor_y(y_m: FloatArray) -> BoolArray:
    """Return whether a place is in the corridor, by its y."""
    return np.asarray((y_m >= 0.0) & (y_m <= WIDTH_M))


def cell_centres() -> FloatArray:
    """Return the centres (80, 2) of all cells."""
    x = np.arange(0.5 * CELL_M, LENGTH_M, CELL_M)
    y = np.arange(-ROOM_M + 0.5 * CELL_M, WIDTH_M + ROOM_M, CELL_M)
    return np.array([(a, b) for a in x for b in y])
