"""A judged layout as a picture: the two predicted errors side by side, beacons and walls on them.

Importing this needs matplotlib, which is an extra: ``pharos[plots]``.
"""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.api.planner_formats import beacons_by_kind, scattered
from app.core.types import FloatArray
from app.services.planning import PlanRequest, PlanResult

MARKERS = {
    "beacon": ("o", "white", "beacon"),
    "add": ("*", "tab:cyan", "to add"),
    "cover": ("D", "tab:orange", "for the bound"),
}


def plan_png(request: PlanRequest, result: PlanResult) -> bytes:
    """Return a PNG; colours end at three bounds, cells without a fix are grey."""
    figure = Figure(figsize=(12.0, 5.5), layout="constrained")
    told = result.prediction
    for axes, name, of_cells in zip(
        figure.subplots(1, 2),
        ("at rest", "walking, last epoch"),
        (told.static_m, told.kinematic_m),
        strict=True,
    ):
        _draw(figure, axes, request, scattered(result, of_cells))
        _mark(axes, request, result)
        axes.set(title=f"predicted error {name} (m)", xlabel="x (m)", ylabel="y (m)")
    if any(beacons_by_kind(request, result).values()):
        figure.axes[0].legend(loc="upper left", fontsize="small")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()


def _draw(figure: Figure, axes: Axes, request: PlanRequest, sigma_m: FloatArray) -> None:
    frame = request.frame
    rows, columns = sigma_m.shape
    right, top = frame.x0_m + columns * frame.cell_m, frame.y0_m + rows * frame.cell_m
    extent = (frame.x0_m, right, frame.y0_m, top)
    no_fix = np.where(np.isinf(sigma_m), 1.0, np.nan)
    axes.imshow(no_fix, origin="lower", extent=extent, cmap="Greys", vmin=0.0, vmax=2.0)
    shown = axes.imshow(
        np.where(np.isfinite(sigma_m), sigma_m, np.nan),
        origin="lower",
        extent=extent,
        cmap="viridis_r",
        vmin=0.0,
        vmax=3.0 * request.bound_m,
    )
    figure.colorbar(shown, ax=axes, extend="max")


def _mark(axes: Axes, request: PlanRequest, result: PlanResult) -> None:
    for wall in request.walls:
        axes.plot((wall.x0_m, wall.x1_m), (wall.y0_m, wall.y1_m), "-", color="black", linewidth=1)
    for kind, anchors in beacons_by_kind(request, result).items():
        if anchors:
            marker, colour, label = MARKERS[kind]
            x_m, y_m = zip(*((a.x_m, a.y_m) for a in anchors), strict=True)
            # Beacons in corners are shown whole.
            drawn = axes.scatter(x_m, y_m, s=60, c=colour, marker=marker, clip_on=False, zorder=3)
            drawn.set_edgecolor("black")
            drawn.set_label(label)
