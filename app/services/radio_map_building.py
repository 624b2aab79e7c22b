"""From surveys to a radio map: placed, cleaned, without wanderers, filled where asked for."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from app.core.fingerprint.cleaning import CleaningParams, LevelStatistics
from app.core.fingerprint.point_survey import Scatter, cleaned_points, level_statistics
from app.core.fingerprint.query import KeyChoice
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map, joined
from app.core.fingerprint.survey import (
    Place,
    beacon_levels,
    beacon_walk_fingerprints,
    chosen_keys,
    has_wifi,
    walk_fingerprints,
)
from app.core.fingerprint.virtual import VirtualParams, virtual_fingerprints
from app.core.fingerprint.wandering import Wanderer, WanderingParams, wanderers, without
from app.core.fusion.survey_walk import (
    PlacedWalk,
    SurveyWalkParams,
    smoothed_walk,
    straight_walk,
)
from app.core.params import MatchParams
from app.core.site import Floor
from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.core.types import WifiScan
from app.services.errors import AppError, ErrorCode

# A surveyor stands at the first and the last waypoint for a moment: scans reported this much before
# and after are placed there.
LEAD_S, TRAIL_S = 1.5, 1.0


class Placing(StrEnum):
    """How the scans of a walk are placed between its waypoints."""

    SMOOTHED = "smoothed"
    STRAIGHT = "straight"


@dataclass(frozen=True, slots=True)
class BuildOptions:
    """What a build does.

    Attributes
    ----------
    virtual
        Whether walkable floor that the survey missed gets virtual fingerprints.
    cleaning
        Whether the scans of a reference point become one cleaned fingerprint.
    placing
        How the scans of walks are placed.
    """

    virtual: bool = True
    cleaning: bool = True
    placing: Placing = Placing.SMOOTHED


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What came of the surveys.

    Attributes
    ----------
    walks, dead_reckoned_walks
        How many, and how many of them were placed along their strides.
    repeated_walks
        Walks that are in the surveys once more, as when a file was uploaded twice; left out.
    beacon_walks
        How many had no Wi-Fi, and became fingerprints of beacons alone.
    scans, placed_scans
        Wi-Fi scans of walks (of those without Wi-Fi, the seconds that heard enough beacons), and
        those that became fingerprints.
    point_scans, reference_points
        Scans of point surveys, and the fingerprints they became.
    other_floors
        Walks and points on floors that the site does not have.
    virtual_fingerprints
        Computed ones.
    kept_out
        Transmitters that moved or changed their address.
    """

    walks: int = 0
    dead_reckoned_walks: int = 0
    repeated_walks: int = 0
    beacon_walks: int = 0
    scans: int = 0
    placed_scans: int = 0
    point_scans: int = 0
    reference_points: int = 0
    other_floors: int = 0
    virtual_fingerprints: int = 0
    kept_out: tuple[Wanderer, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the report as JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class BuiltMap:
    """A radio map, the scatter of its levels if it has reference points, and what came of it."""

    radio_map: RadioMap
    statistics: LevelStatistics | None
    report: BuildReport


@dataclass(slots=True)
class _Placed:
    """Fingerprints so far, and counts for the report."""

    of_walks: list[Fingerprint] = field(default_factory=list)
    of_points: list[Fingerprint] = field(default_factory=list)
    walks: int = 0
    dead_reckoned: int = 0
    beacon_walks: int = 0
    scans: int = 0


def built_map(
    surveyed: Iterable[Surveyed], floors: Sequence[Floor], options: BuildOptions
) -> BuiltMap:
    """Return the radio map of walks and points, the same whatever order they come in.

    Raises
    ------
    AppError
        If nothing of them can be placed on the floors.
    """
    index = {floor.floor_id: i for i, floor in enumerate(floors)}
    every = list(surveyed)
    on_floors = sorted((one for one in every if one.floor_id in index), key=_order)
    here = _without_repetitions(on_floors)
    placed = _placed(here, index, options)
    out = wanderers([*placed.of_walks, *placed.of_points], WanderingParams())
    keys = frozenset(wanderer.key for wanderer in out)
    of_walks, of_points = without(placed.of_walks, keys), without(placed.of_points, keys)
    points, scatter = _points(of_points, options, first_row=len(of_walks))
    if not of_walks and not points:
        detail = "no scan of these surveys can be placed: there would be no radio map"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    radio_map = build_radio_map([floor.floor_id for floor in floors], [*of_walks, *points])
    virtual = _virtual(radio_map, floors) if options.virtual else []
    if virtual:
        radio_map = joined(radio_map, virtual)
    report = BuildReport(
        walks=placed.walks,
        dead_reckoned_walks=placed.dead_reckoned,
        repeated_walks=len(on_floors) - len(here),
        beacon_walks=placed.beacon_walks,
        scans=placed.scans,
        placed_scans=len(of_walks),
        point_scans=len(placed.of_points),
        reference_points=len(points),
        other_floors=len(every) - len(on_floors),
        virtual_fingerprints=len(virtual),
        kept_out=out,
    )
    return BuiltMap(radio_map, level_statistics(radio_map, scatter) if scatter else None, report)


def _order(one: Surveyed) -> tuple[str, str, float]:
    if isinstance(one, SurveyWalk):
        return one.floor_id, one.walk, float(one.waypoints[0, 0])
    return one.floor_id, one.walk, one.time_s or 0.0


def _without_repetitions(surveyed: Iterable[Surveyed]) -> list[Surveyed]:
    """Return the records without walks that are there already.

    Twice the same evidence looks like more evidence: of a transmitter that rotates, of an error.
    """
    seen: set[object] = set()
    kept: list[Surveyed] = []
    for one in surveyed:
        if isinstance(one, SurveyWalk):
            times_s = tuple(scan.time_s for scan in one.scans)
            walked = one.floor_id, one.walk, one.waypoints.tobytes(), times_s
            if walked in seen:
                continue
            seen.add(walked)
        kept.append(one)
    return kept


def _placed(surveyed: list[Surveyed], index: dict[str, int], options: BuildOptions) -> _Placed:
    walks = [one for one in surveyed if isinstance(one, SurveyWalk)]
    rule = chosen_keys(scan for walk in walks for scan in walk.scans), MatchParams()
    placed = _Placed()
    for one in surveyed:
        floor_index = index[one.floor_id]
        if isinstance(one, SurveyPoint):
            placed.of_points.append(_point_fingerprint(one, floor_index))
        else:
            _place_walk(placed, one, floor_index, (options, rule))
    return placed


def _place_walk(
    placed: _Placed,
    walk: SurveyWalk,
    floor_index: int,
    how: tuple[BuildOptions, tuple[KeyChoice, MatchParams]],
) -> None:
    options, rule = how
    first_s, last_s = walk.waypoints[0, 0] - LEAD_S, walk.waypoints[-1, 0] + TRAIL_S
    path = _path(walk, options.placing)

    def place_at(time_s: float) -> Place | None:
        return path.at(time_s) if first_s <= time_s <= last_s else None

    placed.walks += 1
    placed.dead_reckoned += len(path.time_s) > len(walk.waypoints)
    if has_wifi(walk.scans):
        placed.scans += sum(isinstance(scan, WifiScan) for scan in walk.scans)
        placed.of_walks += walk_fingerprints(walk.scans, place_at, floor_index, walk.walk, rule)
        return
    placed.beacon_walks += 1
    placed.scans += sum(1 for _ in beacon_levels(walk.scans, rule))
    placed.of_walks += beacon_walk_fingerprints(walk.scans, place_at, floor_index, walk.walk, rule)


def _path(walk: SurveyWalk, placing: Placing) -> PlacedWalk:
    if placing is Placing.STRAIGHT:
        return straight_walk(walk.waypoints)
    return smoothed_walk(walk.strides, walk.waypoints, SurveyWalkParams())


def _point_fingerprint(point: SurveyPoint, floor_index: int) -> Fingerprint:
    return Fingerprint(
        floor_index,
        point.x_m,
        point.y_m,
        point.wifi_dbm,
        point.ble_dbm,
        point.walk or point.point,
        point.time_s,
    )


def _points(
    scans: list[Fingerprint], options: BuildOptions, first_row: int
) -> tuple[list[Fingerprint], dict[int, Scatter]]:
    """Return the fingerprints of point surveys, and the scatter of the cleaned ones by row."""
    if not options.cleaning:
        return scans, {}
    points = cleaned_points(scans, CleaningParams())
    scatter = {first_row + i: point.scatter for i, point in enumerate(points)}
    return [point.fingerprint for point in points], scatter


def _virtual(radio_map: RadioMap, floors: Sequence[Floor]) -> list[Fingerprint]:
    params = VirtualParams()
    virtual: list[Fingerprint] = []
    for index, floor in enumerate(floors):
        if floor.walkable is not None:
            cells = floor.walkable.cells(params.cell_m)
            virtual += virtual_fingerprints(radio_map, index, cells, params)
    return virtual
