"""Windowed least squares: our kernel against plain NumPy and SciPy, in one run on one machine.

Only the ratios mean something; run it with ``python benchmarks/lateration.py``.
"""

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from app.core.lateration.windowed import Estimate, estimate
from app.core.params import LaterationParams
from app.core.radio.path_loss import SIGMA, X, Y, expected_levels, level_gradients, level_model
from app.core.radio.windows import Window, window_of
from app.core.types import Anchor, FloatArray

EPOCHS, PERIOD_S, WINDOWS = 28, 0.07, 60
CORNERS = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
PARAMS = LaterationParams()
MODEL = level_model(
    [
        Anchor(f"a{i}", (f"mac:{i:012x}",), "f", x, y, path_loss_exponent=1.6)
        for i, (x, y) in enumerate(CORNERS)
    ]
)


def simulated_windows() -> list[Window]:
    """Return windows of a walker, 4 anchors by 28 epochs, 5 dB; the last epoch is time 0."""
    rng, tau_s = np.random.default_rng(1), (np.arange(EPOCHS) - EPOCHS + 1) * PERIOD_S
    windows = []
    for _ in range(WINDOWS):
        x, y = rng.uniform(2.0, 8.0, 2)
        levels = expected_levels(MODEL, x + 0.8 * tau_s, y - 0.6 * tau_s)
        levels = levels + rng.normal(0.0, 5.0, levels.shape)
        anchor = np.tile(np.arange(MODEL.anchors), EPOCHS)
        windows.append(window_of(anchor, np.repeat(tau_s, MODEL.anchors), levels.reshape(-1)))
    return windows


def residuals(state: FloatArray, window: Window) -> FloatArray:
    """Return the normalised residuals (readings,) of a kinematic state (4,)."""
    x, y = state[0] + state[2] * window.time_s, state[1] + state[3] * window.time_s
    rows = np.arange(len(window))
    expected = expected_levels(MODEL, x, y)[rows, window.anchor_index]
    return np.asarray((window.rssi_dbm - expected) / MODEL.table[window.anchor_index, SIGMA])


def scipy_solution(window: Window) -> FloatArray:
    """Return the state by SciPy's robust trust-region solver."""
    start = (*MODEL.table[:, X : Y + 1].mean(axis=0), 0.0, 0.0)
    solution = least_squares(residuals, start, loss="huber", f_scale=1.345, args=(window,))
    return np.asarray(solution.x)


def numpy_solution(window: Window) -> FloatArray:
    """Return the state by an undamped, reweighted Gauss-Newton in plain NumPy."""
    state = np.array([*MODEL.table[:, X : Y + 1].mean(axis=0), 0.0, 0.0])
    rows, tau_s = np.arange(len(window)), window.time_s[:, None]
    for _ in range(10):
        z = residuals(state, window)
        x, y = state[0] + state[2] * window.time_s, state[1] + state[3] * window.time_s
        h = level_gradients(MODEL, x, y)[rows, window.anchor_index] / 5.0
        jacobian = np.hstack((h, h * tau_s))
        weighted = jacobian * np.minimum(1.0, 1.345 / np.maximum(np.abs(z), 1e-9))[:, None]
        step = np.linalg.solve(weighted.T @ jacobian, weighted.T @ z)
        state = state + step
        if np.abs(step[:2]).max() < 1e-3:
            break
    return state


def numba_solution(window: Window, *, kinematic: bool = True) -> FloatArray:
    """Return position and velocity of the product's estimator."""
    result = estimate(window, MODEL, 0.0, kinematic=kinematic, params=PARAMS)
    assert isinstance(result, Estimate)
    fix = result.fix
    return np.array([fix.x_m, fix.y_m, *(fix.velocity_mps or (np.nan, np.nan))])


def median_us(solve: Callable[[Window], FloatArray], windows: list[Window]) -> float:
    """Return the median time of one solution, microseconds, after a first untimed one."""
    solve(windows[0])
    times = []
    for window in windows:
        start = time.perf_counter()
        solve(window)
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))


def main() -> None:
    """Print the table."""
    windows = simulated_windows()
    ours = median_us(numba_solution, windows)
    rows = {
        "app.core.lateration, kinematic": ours,
        "app.core.lateration, static": median_us(
            lambda w: numba_solution(w, kinematic=False), windows
        ),
        "NumPy Gauss-Newton, kinematic": median_us(numpy_solution, windows),
        "scipy least_squares, kinematic": median_us(scipy_solution, windows),
    }
    print("one window of 4 anchors x 28 epochs, start to fix with covariance")
    for name, us in rows.items():
        print(f"  {name:32s} {us:8.0f} us   {us / ours:6.1f} x")


if __name__ == "__main__":
    main()
