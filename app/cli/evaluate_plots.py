"""Pictures of an evaluation: the error curve, and every trace on its floor plan.

Importing this needs matplotlib, which is an extra: ``pharos[plots]``.
"""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

from app.cli.errors import CommandError
from app.formats.ms2020 import floor_folder_of
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.services.evaluation.ms2020 import TEST, ScoredTrace, Task

MARGIN_M = 20.0
"""Plan shown around a trace."""


def plot_walks(
    folder: Path, building: BuildingFolder, scored: Sequence[tuple[Task, ScoredTrace]]
) -> None:
    """Write ``error_cdf.png``, and ``<profile>/<trace>.png`` per test trace, into a folder."""
    tested = [(task, trace) for task, trace in scored if task.split == TEST]
    floors = {floor.name: floor for floor in building.floors}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _save(_error_curves(tested), folder / "error_cdf.png")
        for task, trace in tested:
            (folder / task.profile).mkdir(exist_ok=True)
            drawn = _trace_on_plan(trace, floors[floor_folder_of(task.path).name])
            _save(drawn, folder / task.profile / f"{trace.trace_id}.png")
    except OSError as error:
        msg = f"the pictures cannot be written: {error}"
        raise CommandError(msg) from error


def _figure() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    return figure, figure.add_subplot()


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=100)


def _error_curves(tested: Sequence[tuple[Task, ScoredTrace]]) -> Figure:
    figure, axes = _figure()
    for profile in dict.fromkeys(task.profile for task, _ in tested):
        of_profile = (trace.walk for task, trace in tested if task.profile == profile)
        errors_m = [s.error_m for walk in of_profile for s in walk.seconds if s.error_m is not None]
        if errors_m:
            axes.ecdf(errors_m, label=profile)
    axes.set(xlabel="error (m)", ylabel="share of seconds", xlim=(0.0, None))
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend()
    return figure


def _trace_on_plan(trace: ScoredTrace, floor: FloorFolder) -> Figure:
    figure, axes = _figure()
    left, low = floor.x0_m, floor.y0_m
    extent = (left, left + floor.width_m, low, low + floor.height_m)
    axes.imshow(imread(io.BytesIO(floor.plan_png)), extent=extent)
    truth = np.array([(s.truth.x_m, s.truth.y_m) for s in trace.walk.seconds]).reshape(-1, 2)
    told = [s.answer for s in trace.walk.seconds if s.answer is not None]
    answers = np.array([(a.x_m, a.y_m) for a in told]).reshape(-1, 2)
    axes.plot(*truth.T, "-", color="tab:green", label="truth")
    axes.plot(*answers.T, ".-", color="tab:red", label="answers, once a second")
    around = np.concatenate([truth, answers])
    if len(around):
        (x0, y0), (x1, y1) = around.min(axis=0) - MARGIN_M, around.max(axis=0) + MARGIN_M
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
    axes.set(title=f"{trace.trace_id} on {floor.name}", xlabel="x (m)", ylabel="y (m)")
    axes.legend()
    return figure
