"""The survey report: where a radio map is good and where not, and what to do about it first."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from app.core.fingerprint.quality import (
    ErrorModel,
    LeftOut,
    QualityParams,
    fit_error_model,
    left_out_fixes,
    predicted_error_m,
)
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ReportParams:
    """What is told, and how coarsely.

    Attributes
    ----------
    quality
        How errors are predicted.
    cell_m
        Grid of places.
    spot_m
        Radius of a thin spot: what one short walk more would cover.
    spots
        Thin spots, conflicts and wrong-floor risks told at most.
    far_m
        Scans matched with a place farther away than this are in conflict with it: far beyond what
        fading alone does (the 95th percentile on ms2020 is about 18 m).
    group_m
        Conflicts are told per square of this edge.
    """

    quality: QualityParams = field(default_factory=QualityParams)
    cell_m: float = 3.0
    spot_m: float = 6.0
    spots: int = 10
    far_m: float = 20.0
    group_m: float = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Places (n,) of the grid.

    Attributes
    ----------
    predicted_error_m
        Of a single scan there.
    nearest_scan_m
        Distance to the nearest surveyed scan; inf on a floor without one.
    """

    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    predicted_error_m: FloatArray
    nearest_scan_m: FloatArray


@dataclass(frozen=True, slots=True)
class ThinSpot:
    """A place worth a walk: ``cost_share`` of all error lies there above what dense survey has."""

    floor_index: int
    x_m: float
    y_m: float
    predicted_error_m: float
    nearest_scan_m: float
    cost_share: float


@dataclass(frozen=True, slots=True)
class Conflict:
    """A place whose scans look like those of another one, far away or on another floor."""

    floor_index: int
    x_m: float
    y_m: float
    like_floor_index: int
    like_x_m: float
    like_y_m: float
    scans: int
    share: float


@dataclass(frozen=True, slots=True)
class FloorQuality:
    """What is known of a floor's survey; errors are leave-one-walk-out, None without a scan."""

    floor_index: int
    walks: int
    scans: int
    transmitters_per_scan: float | None
    median_error_m: float | None
    p95_error_m: float | None
    wrong_floor_share: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SurveyReport:
    """All of it; ``left_out`` are the surveyed scans that it was learned from."""

    left_out: LeftOut
    cells: Cells
    floors: tuple[FloorQuality, ...]
    thin_spots: tuple[ThinSpot, ...]
    conflicts: tuple[Conflict, ...]
    wrong_floors: tuple[Conflict, ...]


def survey_report(
    radio_map: RadioMap,
    places: Sequence[FloatArray],
    matching: MatchParams,
    params: ReportParams,
    walks: frozenset[str] | None = None,
) -> SurveyReport:
    """Return the report of a radio map.

    Parameters
    ----------
    places
        Per floor of the map, the places (n, 2) of a grid of ``cell_m`` where people walk.
    walks
        Tell only of the scans of these walks; cells and thin spots are still the whole map's. None:
        of all.

    Raises
    ------
    ValueError
        If the map has no surveyed scan.
    """
    left_out = left_out_fixes(radio_map, matching)
    model = fit_error_model(left_out, params.quality)
    cells = _cells(model, places)
    if walks is not None:
        left_out = left_out.of_walks(walks)
    floors = tuple(_floor_quality(left_out, i) for i in range(len(places)))
    other_floor = (left_out.fix_floor_index >= 0) & (
        left_out.fix_floor_index != left_out.floor_index
    )
    far = (left_out.fix_floor_index == left_out.floor_index) & (left_out.error_m > params.far_m)
    return SurveyReport(
        left_out=left_out,
        cells=cells,
        floors=floors,
        thin_spots=tuple(_thin_spots(cells, model, params)),
        conflicts=tuple(_conflicts(left_out, np.flatnonzero(far), params)),
        wrong_floors=tuple(_conflicts(left_out, np.flatnonzero(other_floor), params)),
    )


def _cells(model: ErrorModel, places: Sequence[FloatArray]) -> Cells:
    floor_index = np.repeat(np.arange(len(places)), [len(p) for p in places])
    xy_m = np.concatenate([np.reshape(p, (-1, 2)) for p in places])
    nearest_m = np.full(len(xy_m), np.inf)
    for floor in range(len(places)):
        surveyed = model.left_out.places()[model.left_out.floor_index == floor]
        here = floor_index == floor
        if len(surveyed) and here.any():
            nearest_m[here] = cKDTree(surveyed).query(xy_m[here])[0]
    predicted_m = predicted_error_m(model, xy_m, floor_index)
    return Cells(floor_index, xy_m[:, 0], xy_m[:, 1], predicted_m, nearest_m)


def _floor_quality(left_out: LeftOut, floor_index: int) -> FloorQuality:
    here = left_out.floor_index == floor_index
    if not here.any():
        return FloorQuality(floor_index, 0, 0, None, None, None, None)
    fixed = here & (left_out.fix_floor_index >= 0)
    error_m = left_out.error_m[fixed]
    wrong = left_out.fix_floor_index[fixed] != floor_index
    return FloorQuality(
        floor_index=floor_index,
        walks=len(np.unique(left_out.walk[here])),
        scans=int(here.sum()),
        transmitters_per_scan=float(left_out.transmitters[here].mean()),
        median_error_m=float(np.median(error_m)) if len(error_m) else None,
        p95_error_m=float(np.percentile(error_m, 95.0)) if len(error_m) else None,
        wrong_floor_share=float(wrong.mean()) if len(error_m) else None,
    )


def _thin_spots(cells: Cells, model: ErrorModel, params: ReportParams) -> list[ThinSpot]:
    """Return discs that hold most error above the dense survey's, greedily, none overlapping."""
    avoidable_m = np.maximum(cells.predicted_error_m - model.base_m, 0.0)
    all_m = float(cells.predicted_error_m.sum())
    # Floors far apart in one plane: a disc never holds cells of two.
    apart = cells.floor_index * 1e6
    tree = cKDTree(np.column_stack([cells.x_m + apart, cells.y_m]))
    discs = tree.query_ball_point(tree.data, params.spot_m)
    spots: list[ThinSpot] = []
    free = np.ones(len(avoidable_m), dtype=np.bool_)
    while len(spots) < params.spots and free.any():
        cost_m = np.array([float((avoidable_m * free)[disc].sum()) for disc in discs])
        best = int(np.argmax(np.where(free, cost_m, -1.0)))
        if cost_m[best] <= 0.0:
            break
        spots.append(
            ThinSpot(
                floor_index=int(cells.floor_index[best]),
                x_m=float(cells.x_m[best]),
                y_m=float(cells.y_m[best]),
                predicted_error_m=float(cells.predicted_error_m[best]),
                nearest_scan_m=float(cells.nearest_scan_m[best]),
                cost_share=float(cost_m[best]) / all_m,
            )
        )
        free[discs[best]] = False
    return spots


def _conflicts(left_out: LeftOut, scans: IntArray, params: ReportParams) -> list[Conflict]:
    """Return the squares that most of these scans lie in, each with the square they look like."""
    squares = [
        np.column_stack([floor, np.floor(x_m / params.group_m), np.floor(y_m / params.group_m)])
        for floor, x_m, y_m in (
            (left_out.floor_index, left_out.x_m, left_out.y_m),
            (left_out.fix_floor_index, left_out.fix_x_m, left_out.fix_y_m),
        )
    ]
    pairs, of_pair, counts = np.unique(
        np.column_stack(squares)[scans], axis=0, return_inverse=True, return_counts=True
    )
    found = []
    for i in np.argsort(-counts, kind="stable")[: params.spots].tolist():
        members = scans[of_pair.ravel() == i]
        around = (squares[0] == pairs[i, :3]).all(axis=1)
        found.append(
            Conflict(
                floor_index=int(pairs[i, 0]),
                x_m=float(left_out.x_m[members].mean()),
                y_m=float(left_out.y_m[members].mean()),
                like_floor_index=int(pairs[i, 3]),
                like_x_m=float(left_out.fix_x_m[members].mean()),
                like_y_m=float(left_out.fix_y_m[members].mean()),
                scans=len(members),
                share=len(members) / int(around.sum()),
            )
        )
    return found
