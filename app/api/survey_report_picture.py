"""A floor of a survey report as a picture: predicted error on the plan, scans, thin spots.

Importing this needs matplotlib, which is an extra: ``pharos[plots]``.
"""

import io

from matplotlib.figure import Figure
from matplotlib.image import imread

from app.services.survey_reports import Reported

WORST_M = 15.0
"""Colours end here: beyond, a place is as good as not surveyed."""


def floor_pictures(reported: Reported) -> dict[str, bytes]:
    """Return a PNG by floor id."""
    ids = [floor.floor_id for floor in reported.floors]
    return {floor_id: _floor_png(reported, index) for index, floor_id in enumerate(ids)}


def _floor_png(reported: Reported, index: int) -> bytes:
    floor, report = reported.floors[index], reported.report
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.add_subplot()
    extent = (floor.x0_m, floor.x0_m + floor.width_m, floor.y0_m, floor.y0_m + floor.height_m)
    plan = reported.plans[index]
    if plan is not None and plan.media_type == "image/png":
        axes.imshow(imread(io.BytesIO(plan.image)), extent=extent, alpha=0.5)
    here = report.cells.floor_index == index
    shown = axes.scatter(
        report.cells.x_m[here],
        report.cells.y_m[here],
        c=report.cells.predicted_error_m[here],
        s=14,
        marker="s",
        cmap="viridis_r",
        vmin=0.0,
        vmax=WORST_M,
        alpha=0.8,
    )
    figure.colorbar(shown, ax=axes, extend="max", label="predicted error of a single scan (m)")
    surveyed = report.left_out.floor_index == index
    axes.plot(report.left_out.x_m[surveyed], report.left_out.y_m[surveyed], "k.", markersize=2)
    for rank, spot in enumerate(report.thin_spots, start=1):
        if spot.floor_index == index:
            axes.annotate(str(rank), (spot.x_m, spot.y_m), color="red", fontsize=14, weight="bold")
    axes.set(title=floor.name, xlabel="x (m)", ylabel="y (m)", xlim=extent[:2], ylim=extent[2:])
    axes.set_aspect("equal")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()
