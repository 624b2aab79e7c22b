"""The deployment planner: what a layout of beacons promises on a floor, and how to better it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from sqlalchemy import Connection

from app.core.geometry import Walkable
from app.core.lateration.placement import Choices, best_additions, fewest_for_bound
from app.core.lateration.planning import (
    FixRule,
    Ground,
    Prediction,
    information,
    leave_one_out_m2,
    prediction,
    traces,
)
from app.core.lateration.predicted import Schedule, cell_centres
from app.core.radio.path_loss import level_model
from app.core.radio.walls import NO_WALLS, HearingParams, TooManyWallsError, heard
from app.core.site import Wall
from app.core.types import Anchor, BoolArray, FloatArray
from app.formats.floor_map import FloorMapError, parse_floor_map
from app.services.errors import invalid_field
from app.storage import floors
from app.storage.beacons import anchors_of_site
from app.storage.floors import StoredFloor

MAX_CELLS = 100_000
"""A floor of 150 by 150 m at 0.5 m: 5 MB of JSON."""

MAX_CELL_BEACONS = 5_000_000
"""Cells times beacons: a fifth of a second, and 80 MB while beacons are left out in turn."""

MAX_WALLS = 20_000
"""Stretches of wall; a large mall has a few thousand."""

MAX_CANDIDATES = 600
MAX_CANDIDATE_CELLS = 12_000_000
"""Places tried for a new beacon, and those times cells: 0.1 s for each beacon looked for."""

MAX_COVER = 100
"""Beacons to look for when a bound is to be kept everywhere."""

HANGING_MARGIN_M = 1.5
"""New beacons hang over walkable floor or on a wall beside it."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A rectangle in the site frame and the edge of the cells it is cut into."""

    x0_m: float
    y0_m: float
    width_m: float
    height_m: float
    cell_m: float


@dataclass(frozen=True, slots=True)
class Tasks:
    """What to look for beyond the prediction; ``kinematic`` says which error is to be bettered."""

    drop_one: bool = False
    add: int = 0
    cover_m: float | None = None
    kinematic: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """A layout and the conditions that it is judged under.

    Attributes
    ----------
    walkable
        Where people walk, None: everywhere in the frame.
    new_anchor
        What beacons that are to be added are like; its place does not matter.
    """

    frame: Frame
    anchors: tuple[Anchor, ...]
    new_anchor: Anchor
    walls: tuple[Wall, ...] = ()
    walkable: Walkable | None = None
    schedule: Schedule = field(default_factory=Schedule)
    hearing: HearingParams = field(default_factory=HearingParams)
    phone_height_m: float = 0.0
    min_beacons: int = 3
    bound_m: float = 2.0
    tasks: Tasks = Tasks()


@dataclass(frozen=True, slots=True)
class Figures:
    """Predicted error over the floor; infinite where there is no fix.

    ``below_share`` is the share of the cells at or below the bound, ``variance_m2`` the mean of
    trace D over the cells.
    """

    min_m: float
    median_m: float
    max_m: float
    bound_m: float
    below_share: float
    variance_m2: float


@dataclass(frozen=True, slots=True)
class Step:
    """A beacon that is left out or added, and what the floor is like then."""

    anchor: Anchor
    figures: Figures


@dataclass(frozen=True, slots=True)
class CoverPlan:
    """Beacons to add for a bound, which is kept everywhere with them if ``reached``."""

    reached: bool
    anchors: tuple[Anchor, ...]
    figures: Figures


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """A judged layout.

    Attributes
    ----------
    inside : (rows, columns)
        Which cells are floor, row 0 at the lowest y; ``prediction`` has one value for each of them,
        row by row.
    dropped
        The layout without each of its beacons, the one that matters most first.
    """

    inside: BoolArray
    prediction: Prediction
    static: Figures
    kinematic: Figures
    dropped: tuple[Step, ...] | None = None
    added: tuple[Step, ...] | None = None
    cover: CoverPlan | None = None


StoredLayout: TypeAlias = tuple[tuple[Anchor, ...], Walkable | None, tuple[Wall, ...]]


def stored_layout(
    connection: Connection, floor: StoredFloor, materials_db: Mapping[str, float]
) -> StoredLayout:
    """Return a floor's beacons, walkable raster and walls as registered."""
    anchors = anchors_of_site(connection, floor.site_id)
    document = floors.get_map(connection, floor.floor_id)
    try:
        walls = () if document is None else parse_floor_map(document, materials_db).walls
    except FloorMapError as error:
        detail = f"the floor's map: {error.detail}"
        raise invalid_field(pointer="#/materials", detail=detail) from error
    on_floor = tuple(anchor for anchor in anchors if anchor.floor_id == floor.floor_id)
    return on_floor, floors.get_walkable(connection, floor.floor_id), walls


def plan(request: PlanRequest) -> PlanResult:
    """Judge a layout and do what is asked; takes up to some seconds, and holds no lock meanwhile.

    Raises
    ------
    AppError
        If the floor, its walls or the layout are too large for it.
    """
    try:
        return _planned(_Planner(request), request.tasks)
    except TooManyWallsError as error:
        detail = f"{error}: take larger cells"
        raise invalid_field(pointer="#/cell_m", detail=detail) from error


def _planned(planner: "_Planner", tasks: Tasks) -> PlanResult:
    return PlanResult(
        planner.inside,
        planner.prediction,
        planner.figures(planner.information, kinematic=False),
        planner.figures(planner.information, kinematic=True),
        planner.dropped() if tasks.drop_one else None,
        planner.added(tasks.add) if tasks.add else None,
        None if tasks.cover_m is None else planner.cover(tasks.cover_m),
    )


class _Planner:
    """One request's arrays, made once."""

    def __init__(self, request: PlanRequest) -> None:
        self._request = request
        self.inside, self._ground = _ground(request)
        self._model = level_model(request.anchors, request.phone_height_m)
        ground, hearing = self._ground, request.hearing
        self._audible = heard(self._model, ground.x_m, ground.y_m, ground.walls, hearing)
        self.information = information(self._model, ground, self._audible)
        self.prediction = prediction(
            self.information, self._rule(kinematic=False), self._rule(kinematic=True)
        )
        self._asked = self._rule(kinematic=request.tasks.kinematic)

    def figures(
        self, epoch: FloatArray, *, kinematic: bool, bound_m: float | None = None
    ) -> Figures:
        """Return the error that an epoch's information (cells, 4) leaves."""
        trace_m2 = traces(epoch, self._rule(kinematic=kinematic), 0.0)
        return _figures(trace_m2, self._request.bound_m if bound_m is None else bound_m)

    def dropped(self) -> tuple[Step, ...]:
        """Return the layout without each beacon, the most missed first."""
        trace_m2 = leave_one_out_m2(self._model, self._ground, self._audible, self._asked)
        # A cell without a fix counts the same however much it lacks, and more than all others.
        cost_m2 = np.minimum(trace_m2, self._ground.prior_m2).mean(axis=1)
        anchors, bound_m = self._request.anchors, self._request.bound_m
        return tuple(
            Step(anchors[i], _figures(trace_m2[i], bound_m))
            for i in np.argsort(-cost_m2, kind="stable")
        )

    def added(self, count: int) -> tuple[Step, ...]:
        """Return the next beacons, each with what the floor is like after it."""
        candidates, choices = self._candidates()
        chosen = best_additions(self._ground, self.information, choices, count)
        steps, epoch = [], self.information
        for anchor in _named("add", (candidates[i] for i in chosen)):
            epoch = epoch + self._information_of([anchor])
            figures = self.figures(epoch, kinematic=self._request.tasks.kinematic)
            steps.append(Step(anchor, figures))
        return tuple(steps)

    def cover(self, bound_m: float) -> CoverPlan:
        """Return the fewest beacons found that keep a bound."""
        candidates, choices = self._candidates()
        found = fewest_for_bound(self._ground, self.information, choices, bound_m, MAX_COVER)
        anchors = _named("cover", (candidates[i] for i in found.chosen))
        epoch = self.information + self._information_of(anchors)
        figures = self.figures(epoch, kinematic=self._request.tasks.kinematic, bound_m=bound_m)
        return CoverPlan(found.reached, anchors, figures)

    def _rule(self, *, kinematic: bool) -> FixRule:
        factor = self._request.schedule.position_factor(kinematic=kinematic)
        return FixRule(factor, self._request.min_beacons)

    def _candidates(self) -> tuple[list[Anchor], Choices]:
        candidates = _candidates(self._request, len(self._ground.x_m))
        model = level_model(candidates, self._request.phone_height_m)
        return candidates, Choices(model, self._request.hearing, self._asked)

    def _information_of(self, anchors: Sequence[Anchor]) -> FloatArray:
        ground, hearing = self._ground, self._request.hearing
        model = level_model(anchors, self._request.phone_height_m)
        audible = heard(model, ground.x_m, ground.y_m, ground.walls, hearing)
        return information(model, ground, audible)


def _figures(trace_m2: FloatArray, bound_m: float) -> Figures:
    sigma_m = np.sqrt(trace_m2)
    return Figures(
        float(sigma_m.min()),
        float(np.median(sigma_m)),
        float(sigma_m.max()),
        bound_m,
        float(np.mean(sigma_m <= bound_m)),
        float(trace_m2.mean()),
    )


def _named(kind: str, anchors: Iterable[Anchor]) -> tuple[Anchor, ...]:
    return tuple(replace(a, anchor_id=f"{kind}-{i + 1}") for i, a in enumerate(anchors))


def _ground(request: PlanRequest) -> tuple[BoolArray, Ground]:
    """Return which cells of the frame are floor, and those cells."""
    frame = request.frame
    count = round(frame.width_m / frame.cell_m) * round(frame.height_m / frame.cell_m)
    if not 0 < count <= MAX_CELLS:
        detail = f"{count} cells of this edge, not 1 to {MAX_CELLS}"
        raise invalid_field(pointer="#/cell_m", detail=detail)
    if count * len(request.anchors) > MAX_CELL_BEACONS:
        detail = f"more than {MAX_CELL_BEACONS} cells times beacons: take larger cells"
        raise invalid_field(pointer="#/cell_m", detail=detail)
    x_m, y_m = cell_centres(frame.width_m, frame.height_m, frame.cell_m)
    x_m, y_m = x_m + frame.x0_m, y_m + frame.y0_m
    inside = np.ones(x_m.shape, dtype=np.bool_)
    if request.walkable is not None:
        inside = request.walkable.distances_at(x_m, y_m) == 0.0
        if not inside.any():
            raise invalid_field(pointer="#/cell_m", detail="no cell's centre is on walkable floor")
    return inside, Ground(x_m[inside], y_m[inside], _wall_rows(request.walls))


def _wall_rows(walls: Sequence[Wall]) -> FloatArray:
    if not walls:
        return NO_WALLS
    if len(walls) > MAX_WALLS:
        detail = f"{len(walls)} stretches of wall, more than {MAX_WALLS}"
        raise invalid_field(pointer="#/walls", detail=detail)
    rows = [(w.x0_m, w.y0_m, w.x1_m, w.y1_m, w.attenuation_db) for w in walls]
    return np.array(rows, dtype=np.float64)


def _candidates(request: PlanRequest, cells: int) -> list[Anchor]:
    """Return beacons on an even grid over the frame, edges and corners included."""
    frame = request.frame
    most = max(min(MAX_CANDIDATES, MAX_CANDIDATE_CELLS // cells), 1)
    spacing_m = max(frame.cell_m, np.sqrt(frame.width_m * frame.height_m / most))
    x_m = np.linspace(0.0, frame.width_m, int(frame.width_m / spacing_m) + 1) + frame.x0_m
    y_m = np.linspace(0.0, frame.height_m, int(frame.height_m / spacing_m) + 1) + frame.y0_m
    x_m, y_m = (axis.ravel() for axis in np.meshgrid(x_m, y_m))
    free = np.ones(len(x_m), dtype=np.bool_)
    if request.walkable is not None:
        free = request.walkable.distances_at(x_m, y_m) <= HANGING_MARGIN_M
    for anchor in request.anchors:
        # Two beacons in one place tell less than two, and only because the model has white noise.
        free &= np.hypot(x_m - anchor.x_m, y_m - anchor.y_m) >= spacing_m / 2
    return [
        replace(request.new_anchor, x_m=float(x), y_m=float(y))
        for x, y in zip(x_m[free], y_m[free], strict=True)
    ]
