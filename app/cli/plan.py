"""``pharos plan``: what a layout of beacons promises, before a single one hangs."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.api.errors import field_errors
from app.api.planner_formats import plan_geojson, plan_json
from app.api.planner_layout import request_of_layout
from app.api.planner_schema import Layout
from app.cli.errors import CommandError
from app.cli.files import write_file
from app.core.georeference import ControlPoint, Georeference, fit_georeference
from app.services.errors import AppError
from app.services.planning import CoverPlan, Figures, PlanRequest, PlanResult, Step
from app.services.planning import plan as judge

STDOUT = Path("-")
MAX_BOUND_M = 100.0

_METRES = re.compile(r"(\d+(?:\.\d+)?)\s*m?")


def plan(  # noqa: PLR0913 - one parameter per option
    layout: Annotated[
        Path, typer.Argument(metavar="LAYOUT.json", help="Frame, beacons and conditions.")
    ],
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="OUT", help="Write figures and grids; - for stdout."),
    ] = None,
    geojson_file: Annotated[
        Path | None,
        typer.Option("--geojson", metavar="OUT", help="Write cells; needs control_points."),
    ] = None,
    png_file: Annotated[
        Path | None, typer.Option("--png", metavar="OUT", help="Write a picture.")
    ] = None,
    drop_one: Annotated[
        bool, typer.Option("--drop-one", help="Tell which beacon matters most.")
    ] = False,
    add: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=20, help="Tell where the next N beacons help most."),
    ] = None,
    cover: Annotated[
        str | None,
        typer.Option(metavar="BOUND", help="Add the fewest beacons that keep a bound, as 1.5m."),
    ] = None,
) -> None:
    """Predict the error of a layout of beacons over a floor, and look for a better one.

    What an option asks for comes before what the file asks for.
    """
    options = {"drop_one": drop_one or None, "add": add, "cover_m": _metres(cover)}
    asked = _read(layout).model_copy(
        update={name: value for name, value in options.items() if value is not None}
    )
    georeference = None if geojson_file is None else _georeference(layout, asked)
    try:
        request = request_of_layout(asked)
        result = judge(request)
    except AppError as error:
        raise _refused(layout, error) from error
    if png_file is not None:
        _write(png_file, _png(request, result))
    if geojson_file is not None and georeference is not None:
        document = plan_geojson(request, result, georeference)
        _write(geojson_file, msgspec.json.encode(document))
    if json_file is not None:
        _write(json_file, msgspec.json.encode(plan_json(request, result)) + b"\n")
    if json_file != STDOUT:
        _print(request, result)


def _metres(text: str | None) -> float | None:
    if text is None:
        return None
    match = _METRES.fullmatch(text.strip())
    bound_m = float(match[1]) if match else 0.0
    if not 0.0 < bound_m <= MAX_BOUND_M:
        msg = f"--cover {text!r} is not a bound like 1.5m, up to {MAX_BOUND_M:g} m"
        raise CommandError(msg, 2)
    return bound_m


def _read(path: Path) -> Layout:
    try:
        return Layout.model_validate_json(path.read_bytes())
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror}"
        raise CommandError(msg) from error
    except ValidationError as error:
        places = [{**e, "loc": ("body", *e["loc"])} for e in error.errors(include_url=False)]
        wrong = "; ".join(f"{e.pointer}: {e.detail}" for e in field_errors(places)[:5])
        msg = f"{path}: {wrong}"
        raise CommandError(msg) from error


def _refused(path: Path, error: AppError) -> CommandError:
    wrong = "; ".join(f"{e.pointer}: {e.detail}" for e in error.errors) or error.detail
    return CommandError(f"{path}: {wrong}")


def _georeference(path: Path, layout: Layout) -> Georeference:
    if layout.control_points is None:
        msg = f"--geojson needs control_points in {path}: two or more of x, y, lat, lon"
        raise CommandError(msg, 2)
    try:
        return fit_georeference(
            [ControlPoint(p.x, p.y, p.lat, p.lon) for p in layout.control_points]
        )
    except ValueError as error:
        msg = f"{path}: #/control_points: {error}"
        raise CommandError(msg) from error


def _png(request: PlanRequest, result: PlanResult) -> bytes:
    try:
        from app.api.planner_picture import plan_png  # noqa: PLC0415 - it needs an extra
    except ModuleNotFoundError as error:
        msg = f"--png needs {error.name}: install pharos[plots]"
        raise CommandError(msg) from error
    return plan_png(request, result)


def _write(path: Path, content: bytes) -> None:
    if path == STDOUT:
        typer.echo(content, nl=False)
        return
    write_file(path, content)


def _print(request: PlanRequest, result: PlanResult) -> None:
    console = Console()
    three = 100.0 * float((result.prediction.in_range >= 3).mean())
    told = Table(
        title="Predicted error over the floor",
        caption=f"{len(request.anchors)} beacons; three or more are heard on {three:.1f} % of it",
    )
    _add_columns(told, ("",), request.bound_m)
    told.add_row("at rest", *_cells(result.static))
    told.add_row("walking, at the window's end", *_cells(result.kinematic))
    console.print(told)
    if result.dropped is not None:
        title = "Without one beacon, the most missed first"
        console.print(_steps_table(title, result.dropped, request.bound_m))
    if result.added is not None:
        title = "The next beacons, one after the other"
        console.print(_steps_table(title, result.added, request.bound_m))
    if result.cover is not None:
        console.print(_cover_table(result.cover))


def _cover_table(cover: CoverPlan) -> Table:
    figures = cover.figures
    kept = "keep" if cover.reached else "do not keep"
    share = f"{100.0 * figures.below_share:.1f} % of the floor within it"
    table = Table(
        title=f"{len(cover.anchors)} more beacons {kept} {figures.bound_m:g} m everywhere",
        caption=f"median {_finite(figures.median_m)}, max {_finite(figures.max_m)} m; {share}",
        min_width=60,
    )
    for heading in ("beacon", "x", "y"):
        table.add_column(heading, no_wrap=True)
    for anchor in cover.anchors:
        table.add_row(anchor.anchor_id, f"{anchor.x_m:.2f}", f"{anchor.y_m:.2f}")
    return table


def _steps_table(title: str, steps: Sequence[Step], bound_m: float) -> Table:
    table = Table(title=title)
    _add_columns(table, ("beacon", "x", "y"), bound_m)
    for step in steps:
        anchor = step.anchor
        place = (f"{anchor.x_m:.2f}", f"{anchor.y_m:.2f}")
        table.add_row(escape(anchor.anchor_id), *place, *_cells(step.figures))
    return table


def _add_columns(table: Table, first: Sequence[str], bound_m: float) -> None:
    for heading in first:
        table.add_column(heading, no_wrap=True)
    for heading in ("min m", "median m", "max m", f"within {bound_m:g} m", "mean D m²"):
        table.add_column(heading, justify="right")


def _cells(figures: Figures) -> tuple[str, ...]:
    lengths = (figures.min_m, figures.median_m, figures.max_m)
    return (
        *map(_finite, lengths),
        f"{100.0 * figures.below_share:.1f} %",
        _finite(figures.variance_m2),
    )


def _finite(value: float) -> str:
    return "no fix" if math.isinf(value) else f"{value:.2f}"
