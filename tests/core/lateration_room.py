"""The room of Grinyak et al. 2018: 10 x 10 m, 5 dB, windows of 28 epochs of 0.07 s."""

import numpy as np

from app.core.radio.path_loss import LevelModel, expected_levels, level_model
from app.core.radio.windows import Window, window_of
from app.core.types import Anchor

CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
WALL_MIDDLES = ((5.0, 0.0), (10.0, 5.0), (5.0, 10.0), (0.0, 5.0))
EPOCHS, PERIOD_S, NOW_S = 28, 0.07, 1000.0


def anchors_at(places, exponent=1.6) -> tuple[Anchor, ...]:
    return tuple(
        Anchor(f"a{i}", (f"mac:{i:012x}",), "f", x, y, path_loss_exponent=exponent)
        for i, (x, y) in enumerate(places)
    )


def corners() -> LevelModel:
    return level_model(anchors_at(CORNERS))


def corners_and_middles() -> LevelModel:
    return level_model(anchors_at(CORNERS + WALL_MIDDLES))


def window_at(
    model, place, rng, *, velocity=(0.0, 0.0), offset_db=0.0, noise_db=5.0, epochs=EPOCHS
) -> Window:
    """A phone that is at ``place`` at the last epoch, `NOW_S`."""
    tau_s = (np.arange(epochs) - (epochs - 1)) * PERIOD_S
    levels = expected_levels(model, place[0] + velocity[0] * tau_s, place[1] + velocity[1] * tau_s)
    levels = levels + offset_db + rng.normal(0.0, noise_db, levels.shape)
    n = model.anchors
    return window_of(np.tile(np.arange(n), epochs), NOW_S + np.repeat(tau_s, n), levels.reshape(-1))
