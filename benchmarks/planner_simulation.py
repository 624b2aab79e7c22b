"""Simulated windows against the planner: whether a fix errs by what the map of sigma_xy says.

In a room of 10 x 10 m, in every cell of 0.5 m that is at least 1 m from a beacon, 40 windows of a
phone at rest are simulated (5 dB, 28 epochs of 0.07 s, n = 1.6) and solved by plain least squares,
which the prediction is for, and by the server's own estimator. Printed are the median over the
cells of measured over predicted error, and the share of cells within 35 %. Run it with
``python benchmarks/planner_simulation.py [SEED]``; it takes about a minute.
"""

import sys

import numpy as np

from app.core.lateration.gauss_newton import minimise
from app.core.lateration.planning import Ground, predict
from app.core.lateration.predicted import Schedule, cell_centres
from app.core.lateration.windowed import Estimate, estimate
from app.core.params import LaterationParams
from app.core.radio.path_loss import SIGMA, LevelModel, X, Y, expected_levels, level_model
from app.core.radio.walls import HearingParams
from app.core.radio.windows import Window, window_of
from app.core.types import Anchor, FloatArray

EPOCHS, PERIOD_S, NOISE_DB, WINDOWS = 28, 0.07, 5.0, 40
CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
MIDDLES = ((5.0, 0.0), (10.0, 5.0), (5.0, 10.0), (0.0, 5.0))
PARAMS = LaterationParams()


def room(places: tuple[tuple[float, float], ...]) -> LevelModel:
    """Return the level models of beacons at places."""
    return level_model(
        [
            Anchor(f"b{i}", (), "", x, y, path_loss_exponent=1.6, shadowing_db=NOISE_DB)
            for i, (x, y) in enumerate(places)
        ]
    )


def window_at(model: LevelModel, place: FloatArray, rng: np.random.Generator) -> Window:
    """Return the levels of a phone at rest; the last epoch is time 0."""
    n, tau_s = model.anchors, (np.arange(EPOCHS) - (EPOCHS - 1)) * PERIOD_S
    levels = np.tile(expected_levels(model, place[:1], place[1:])[0], EPOCHS)
    noisy = levels + rng.normal(0.0, NOISE_DB, len(levels))
    return window_of(np.tile(np.arange(n), EPOCHS), np.repeat(tau_s, n), noisy)


def least_squares(
    window: Window, model: LevelModel, place: FloatArray, *, kinematic: bool
) -> FloatArray:
    """Return the fix of least squares without robust weights and priors, begun at the truth."""
    precision = 1.0 / model.table[window.anchor_index, SIGMA]
    rows = (window.anchor_index, window.time_s, window.rssi_dbm, precision)
    start = np.array([*place, 0.0, 0.0] if kinematic else place)
    return np.asarray(minimise(rows, model.table, start, (1e6, 0.0, 0.0))[0][:2])


def server(window: Window, model: LevelModel, _place: FloatArray, *, kinematic: bool) -> FloatArray:
    """Return the fix of the server's estimator."""
    result = estimate(window, model, 0.0, kinematic=kinematic, params=PARAMS)
    assert isinstance(result, Estimate)
    return np.array((result.fix.x_m, result.fix.y_m))


def main() -> None:
    """Print the table."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 2018
    x_m, y_m = cell_centres(10.0, 10.0, 0.5)
    ground = Ground(x_m.ravel(), y_m.ravel())
    places = np.column_stack((ground.x_m, ground.y_m))
    for beacons in (CORNERS, CORNERS + MIDDLES):
        model = room(beacons)
        predicted = predict(ground, model, Schedule(EPOCHS, PERIOD_S), HearingParams())
        apart_m = np.linalg.norm(places[:, None] - model.table[None, :, X : Y + 1], axis=2)
        far = apart_m.min(axis=1) >= 1.0
        for kinematic in (False, True):
            sigma_m = (predicted.kinematic_m if kinematic else predicted.static_m)[far]
            for solve in (least_squares, server):
                rng, ratios = np.random.default_rng(seed), []
                for place, expected_m in zip(places[far], sigma_m, strict=True):
                    windows = (window_at(model, place, rng) for _ in range(WINDOWS))
                    fixes = np.array([solve(w, model, place, kinematic=kinematic) for w in windows])
                    rms_m = np.sqrt(((fixes - place) ** 2).sum(axis=1).mean())
                    ratios.append(rms_m / expected_m)
                within = np.mean(np.abs(np.array(ratios) - 1.0) <= 0.35)
                print(
                    f"{len(beacons)} beacons  {'kinematic' if kinematic else 'static':9s}  "
                    f"{solve.__name__:13s}  median ratio {np.median(ratios):.2f}  "
                    f"within 35 % {100.0 * within:5.1f} %"
                )


if __name__ == "__main__":
    main()
