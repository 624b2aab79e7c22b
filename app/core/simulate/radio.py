"""How loud every transmitter is at every place: path loss, obstacles, floors, shadowing.

Level of transmitter i at point p (log-distance model, Rappaport 2002, ch. 4)::

    u_i(p) = u*_i - 10 n_i log10(d / d*_i) - L_walls(p) - L_floors(p) + s_i(p)

with d the distance in space. The shadowing ``s_i`` is one Gaussian random field per transmitter, of
standard deviation sigma_i and correlation ``exp(-r / 4 m)`` (Gudmundson 1991). It is drawn once, as
a sum of random Fourier features (Rahimi and Recht 2007)::

    s_i(p) = sigma_i sqrt(2 / F) sum_f cos(w_f . p + phi_f)

The exponential correlation in any dimension has a multivariate Cauchy spectrum, hence
``w = z / (|z0| 4 m)`` with z and z0 standard normal. The field lives in space, not on a floor, so a
level also changes smoothly on the stairs.
"""

from dataclasses import dataclass

import numba
import numpy as np

from app.core.radio.walls import crosses
from app.core.simulate.building import STOREY_HEIGHT_M
from app.core.site import Floor, Wall
from app.core.types import Anchor, FloatArray, IntArray

CORRELATION_M = 4.0
FEATURES = 64
# Loss of one concrete slab at 2.4 GHz: ITU-R P.1238 gives 15 dB and more for one floor.
SLAB_DB = 15.0
# Behind many racks the way over their tops is the louder one: obstacles never cost more than this.
MAX_OBSTACLE_DB = 20.0
PHONE_HEIGHT_M = 1.2
FADING_DB = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class Transmitters:
    """All transmitters of one kind, as arrays for the level kernel.

    Attributes
    ----------
    anchors
        The transmitters as they are (and, for beacons, as the site's registry knows them).
    place : (n, 4)
        x, y, height above the ground floor's floor, storey.
    model : (n, 4)
        u*, d*, n, sigma.
    frequency : (n, F, 3), phase : (n, F)
        The shadowing fields.
    walls : (w, 5), wall_start : (storeys + 1,)
        What weakens a level on its way: x0, y0, x1, y1, dB, storey by storey.
    detection_dbm
        Quieter readings are not heard.
    """

    anchors: tuple[Anchor, ...]
    place: FloatArray
    model: FloatArray
    frequency: FloatArray
    phase: FloatArray
    walls: FloatArray
    wall_start: IntArray
    detection_dbm: float

    def shadowing_db(self, points: FloatArray) -> FloatArray:
        """Return the shadowing at (x, y, storey) points, shape (points, transmitters)."""
        return _shadowing_db(_in_space(points), self.model, self.frequency, self.phase)

    def mean_levels_dbm(self, points: FloatArray) -> FloatArray:
        """Return levels before fading at (x, y, storey) points, shape (points, transmitters)."""
        loss_db = _path_and_obstacle_loss_db(
            points, self.place, self.model, self.walls, self.wall_start
        )
        return self.model[:, 0] - loss_db + self.shadowing_db(points)


def transmitters(
    anchors: tuple[Anchor, ...],
    floors: tuple[Floor, ...],
    detection_dbm: float,
    rng: np.random.Generator,
) -> Transmitters:
    """Return transmitters on floors, with their shadowing fields drawn from ``rng``."""
    floor_ids = [floor.floor_id for floor in floors]
    walls, wall_start = _wall_arrays([floor.walls for floor in floors])
    storey = [floor_ids.index(anchor.floor_id) for anchor in anchors]
    place = [
        (a.x_m, a.y_m, s * STOREY_HEIGHT_M + a.z_m, s) for a, s in zip(anchors, storey, strict=True)
    ]
    model = [
        (a.ref_level_dbm, a.ref_distance_m, a.path_loss_exponent, a.shadowing_db) for a in anchors
    ]
    direction = rng.normal(size=(len(anchors), FEATURES, 3))
    spread = np.abs(rng.normal(size=(len(anchors), FEATURES, 1)))
    return Transmitters(
        anchors=anchors,
        place=np.array(place, dtype=np.float64),
        model=np.array(model, dtype=np.float64),
        frequency=direction / (spread * CORRELATION_M),
        phase=rng.uniform(0.0, 2.0 * np.pi, (len(anchors), FEATURES)),
        walls=walls,
        wall_start=wall_start,
        detection_dbm=detection_dbm,
    )


def _in_space(points: FloatArray) -> FloatArray:
    """Return phone positions in metres from (x, y, storey)."""
    height_m = points[:, 2] * STOREY_HEIGHT_M + PHONE_HEIGHT_M
    return np.column_stack([points[:, :2], height_m])


def _wall_arrays(storeys: list[tuple[Wall, ...]]) -> tuple[FloatArray, IntArray]:
    """Return all walls (x0, y0, x1, y1, dB) storey by storey, and where each storey begins."""
    rows = [(w.x0_m, w.y0_m, w.x1_m, w.y1_m, w.attenuation_db) for walls in storeys for w in walls]
    start = np.concatenate(([0], np.cumsum([len(walls) for walls in storeys])))
    return np.array(rows, dtype=np.float64).reshape(-1, 5), start.astype(np.int64)


@numba.njit(cache=True)
def _path_and_obstacle_loss_db(
    points: FloatArray,
    place: FloatArray,
    model: FloatArray,
    walls: FloatArray,
    wall_start: IntArray,
) -> FloatArray:
    """Return the loss from d* on, shape (points, transmitters).

    Walls count those of the transmitter's storey, less the further the phone is above or below it;
    slabs count in proportion to the difference in storeys.
    """
    loss_db = np.empty((len(points), len(place)))
    for p in range(len(points)):
        x, y, storey = points[p, 0], points[p, 1], points[p, 2]
        height_m = storey * STOREY_HEIGHT_M + PHONE_HEIGHT_M
        for t in range(len(place)):
            u, v = place[t, 0], place[t, 1]
            distance_m = np.sqrt((x - u) ** 2 + (y - v) ** 2 + (height_m - place[t, 2]) ** 2)
            apart = min(abs(storey - place[t, 3]), 1.0)
            obstacles_db = 0.0
            if apart < 1.0:
                floor = int(place[t, 3])
                for w in range(wall_start[floor], wall_start[floor + 1]):
                    if crosses(x, y, u, v, walls[w]):
                        obstacles_db += walls[w, 4]
            ratio = max(distance_m / model[t, 1], 0.3)
            loss_db[p, t] = 10.0 * model[t, 2] * np.log10(ratio) + apart * SLAB_DB
            loss_db[p, t] += (1.0 - apart) * min(obstacles_db, MAX_OBSTACLE_DB)
    return loss_db


@numba.njit(cache=True)
def _shadowing_db(
    space_m: FloatArray, model: FloatArray, frequency: FloatArray, phase: FloatArray
) -> FloatArray:
    """Return the sum of random Fourier features, shape (points, transmitters)."""
    features = phase.shape[1]
    field_db = np.empty((len(space_m), len(phase)))
    for t in range(len(phase)):
        scale_db = model[t, 3] * np.sqrt(2.0 / features)
        for p in range(len(space_m)):
            total = 0.0
            for f in range(features):
                total += np.cos(
                    frequency[t, f, 0] * space_m[p, 0]
                    + frequency[t, f, 1] * space_m[p, 1]
                    + frequency[t, f, 2] * space_m[p, 2]
                    + phase[t, f]
                )
            field_db[p, t] = scale_db * total
    return field_db
