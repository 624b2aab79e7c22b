"""Who is where when: walks along the aisles between random goals, over stairs and lift."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from app.core.simulate.building import CONNECTORS, STOREYS, Connector, ConnectorKind, Segment
from app.core.types import FloatArray, IntArray

TRUTH_RATE_HZ = 10.0
# Free walking speed of adults at work indoors, mean and spread between people (Bohannon 1997 gives
# 1.3 to 1.4 m/s for comfortable gait; carrying and turning take a little off).
PACE_MPS, PACE_SPREAD_MPS = 1.25, 0.1
GOAL_SPACING_M = 4.0
PAUSE_S = (3.0, 25.0)
LIFT_WAIT_S = (3.0, 12.0)
OTHER_FLOOR_SHARE = 0.3
STAIRS_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class Place:
    """A point on a floor."""

    floor_index: int
    x_m: float
    y_m: float


@dataclass(frozen=True, slots=True)
class FloorChange:
    """A passage between floors; the carrier is off the connector from ``end_s`` on."""

    kind: ConnectorKind
    begin_s: float
    end_s: float
    to_floor_index: int


@dataclass(frozen=True, slots=True, eq=False)
class WalkTruth:
    """Where a walker was, ten times a second.

    Attributes
    ----------
    time_s, x_m, y_m : (n,)
        Event time and place.
    storey : (n,)
        Height in storeys, fractional between floors; ``floor_index`` is the nearest whole one.
    walked_m : (n,)
        Distance covered on foot.
    floor_changes
        Passages over stairs and lift that were finished.
    """

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    storey: FloatArray
    walked_m: FloatArray
    floor_changes: tuple[FloorChange, ...]
    floor_index: IntArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "floor_index", np.floor(self.storey + 0.5).astype(np.int64))

    def at(self, time_s: float) -> Place:
        """Return the place at a time, interpolated; before and after the walk, its ends."""
        x_m = float(np.interp(time_s, self.time_s, self.x_m))
        y_m = float(np.interp(time_s, self.time_s, self.y_m))
        storey = float(np.interp(time_s, self.time_s, self.storey))
        return Place(int(np.floor(storey + 0.5)), x_m, y_m)

    def points_at(self, times_s: FloatArray) -> FloatArray:
        """Return (x, y, storey) per time, shape (n, 3)."""
        columns = (self.x_m, self.y_m, self.storey)
        return np.column_stack([np.interp(times_s, self.time_s, column) for column in columns])


@dataclass(frozen=True, slots=True, eq=False)
class RouteGraph:
    """Points of the aisles, their neighbours, and the next hop of every shortest path."""

    places: tuple[Place, ...]
    predecessors: IntArray
    distance_m: FloatArray

    def nearest(self, place: Place) -> int:
        """Return the index of the graph's point nearest to a place on its floor."""
        gaps = [
            np.hypot(p.x_m - place.x_m, p.y_m - place.y_m)
            if p.floor_index == place.floor_index
            else np.inf
            for p in self.places
        ]
        return int(np.argmin(gaps))

    def path(self, start: int, goal: int) -> list[int]:
        """Return the indices of the shortest path, both ends included."""
        path = [goal]
        while path[-1] != start:
            path.append(int(self.predecessors[start, path[-1]]))
        return path[::-1]


def route_graph(connector: ConnectorKind) -> RouteGraph:
    """Return the graph of all aisles where floors are joined by one kind of connector."""
    places: dict[Place, int] = {}
    edges: list[tuple[int, int, float]] = []

    def join(one: Place, other: Place, cost_m: float) -> None:
        a, b = (places.setdefault(p, len(places)) for p in (one, other))
        edges.extend([(a, b, cost_m), (b, a, cost_m)])

    for floor_index, storey in enumerate(STOREYS):
        for aisle in storey.aisles:
            points = [Place(floor_index, x, y) for x, y in _cut(aisle, storey.aisles)]
            for one, other in pairwise(points):
                join(one, other, float(np.hypot(other.x_m - one.x_m, other.y_m - one.y_m)))
    for passage in CONNECTORS:
        if passage.kind is connector:
            join(Place(0, *passage.lower_m), Place(1, *passage.upper_m), passage.duration_s)
    rows, columns, costs = zip(*edges, strict=True)
    graph = csr_array((costs, (rows, columns)), shape=(len(places), len(places)))
    distance_m, predecessors = dijkstra(graph, return_predecessors=True)
    return RouteGraph(tuple(places), predecessors.astype(np.int64), distance_m)


def along(segment: Segment, spacing_m: float) -> list[tuple[float, float]]:
    """Return evenly spaced points of a segment, its ends included, at most ``spacing_m`` apart."""
    x0, y0, x1, y1 = segment
    pieces = max(1, int(np.ceil(np.hypot(x1 - x0, y1 - y0) / spacing_m)))
    return [(x0 + (x1 - x0) * i / pieces, y0 + (y1 - y0) * i / pieces) for i in range(pieces + 1)]


def _cut(aisle: Segment, aisles: tuple[Segment, ...]) -> list[tuple[float, float]]:
    """Return the points of an aisle, in order: ends, crossings with others, and goals between."""
    crossings = {point for other in aisles for point in _crossing(aisle, other)}
    corners = sorted({aisle[:2], aisle[2:]} | crossings)
    points = [corners[0]]
    for one, other in pairwise(corners):
        points.extend(along((*one, *other), GOAL_SPACING_M)[1:])
    return [(float(x), float(y)) for x, y in points]


def _crossing(one: Segment, other: Segment) -> Iterator[tuple[float, float]]:
    """Yield where two axis-parallel segments cross or touch at a right angle."""
    for level, upright in ((one, other), (other, one)):
        if level[1] == level[3] and upright[0] == upright[2]:
            x, y = upright[0], level[1]
            if level[0] <= x <= level[2] and upright[1] <= y <= upright[3]:
                yield (x, y)


class _Timeline:
    """Knots of a walk while it is laid out: time, x, y, storey, distance walked."""

    def __init__(self, place: Place, start_s: float) -> None:
        storey = float(place.floor_index)
        self.knots: list[tuple[float, ...]] = [(start_s, place.x_m, place.y_m, storey, 0.0)]
        self.floor_changes: list[FloorChange] = []

    @property
    def end_s(self) -> float:
        return self.knots[-1][0]

    @property
    def place(self) -> Place:
        _, x_m, y_m, storey, _ = self.knots[-1]
        return Place(round(storey), x_m, y_m)

    def rest(self, duration_s: float) -> None:
        time_s, *where = self.knots[-1]
        self.knots.append((time_s + duration_s, *where))

    def move(self, place: Place, duration_s: float) -> None:
        time_s, x_m, y_m, _, walked_m = self.knots[-1]
        walked_m += float(np.hypot(place.x_m - x_m, place.y_m - y_m))
        storey = float(place.floor_index)
        self.knots.append((time_s + duration_s, place.x_m, place.y_m, storey, walked_m))

    def change_floor(self, passage: Connector, place: Place) -> None:
        begin_s = self.end_s
        self.move(place, passage.duration_s)
        change = FloorChange(passage.kind, begin_s, self.end_s, place.floor_index)
        self.floor_changes.append(change)


def plan_walk(
    graphs: dict[ConnectorKind, RouteGraph],
    rng: np.random.Generator,
    start_s: float,
    duration_s: float,
    begin: Place | None,
) -> WalkTruth:
    """Return one walker's way: goal after goal, with a pause at each."""
    any_graph = graphs[ConnectorKind.STAIRS]
    here = int(rng.integers(len(any_graph.places))) if begin is None else any_graph.nearest(begin)
    pace_mps = float(np.clip(rng.normal(PACE_MPS, PACE_SPREAD_MPS), 0.9, 1.5))
    timeline = _Timeline(begin or any_graph.places[here], start_s)
    _go(timeline, timeline.place, any_graph.places[here], pace_mps, rng)
    while timeline.end_s < start_s + duration_s:
        stairs = rng.random() < STAIRS_SHARE
        graph = graphs[ConnectorKind.STAIRS if stairs else ConnectorKind.LIFT]
        goal = _choose_goal(graph, here, rng)
        for stop in graph.path(here, goal)[1:]:
            _go(timeline, graph.places[here], graph.places[stop], pace_mps, rng)
            here = stop
        timeline.rest(float(rng.uniform(*PAUSE_S)))
    return _sample(timeline, rng, start_s, duration_s)


def _choose_goal(graph: RouteGraph, here: int, rng: np.random.Generator) -> int:
    """Return a goal on this floor, or on the other one for a share of the ways."""
    floor_index = graph.places[here].floor_index
    if rng.random() < OTHER_FLOOR_SHARE:
        floor_index = 1 - floor_index
    goals = [i for i, p in enumerate(graph.places) if p.floor_index == floor_index and i != here]
    return int(rng.choice(goals))


def _go(
    timeline: _Timeline, one: Place, other: Place, pace_mps: float, rng: np.random.Generator
) -> None:
    """Add the way from one point to the next: on foot, or over the connector between floors."""
    if one.floor_index == other.floor_index:
        distance_m = float(np.hypot(other.x_m - one.x_m, other.y_m - one.y_m))
        timeline.move(other, distance_m / (pace_mps * float(rng.uniform(0.92, 1.08))))
        return
    passage = next(c for c in CONNECTORS if c.covers(one.x_m, one.y_m))
    if passage.kind is ConnectorKind.LIFT:
        timeline.rest(float(rng.uniform(*LIFT_WAIT_S)))
    timeline.change_floor(passage, other)


def _sample(
    timeline: _Timeline, rng: np.random.Generator, start_s: float, duration_s: float
) -> WalkTruth:
    """Sample the knots evenly and let the walker sway: nobody keeps to the middle of an aisle.

    The sway depends on the distance walked, so it stands still when the walker does; it stays
    below 0.4 m, less than the clearance of every aisle and door.
    """
    time_s = start_s + np.arange(int(duration_s * TRUTH_RATE_HZ) + 1) / TRUTH_RATE_HZ
    knots = np.array(timeline.knots)
    x_m, y_m, storey, walked_m = (np.interp(time_s, knots[:, 0], knots[:, i]) for i in (1, 2, 3, 4))
    phase_x, phase_y = rng.uniform(0.0, 2.0 * np.pi, 2)
    changes = [c for c in timeline.floor_changes if c.end_s <= time_s[-1]]
    return WalkTruth(
        time_s=time_s,
        x_m=x_m + 0.35 * np.sin(2.0 * np.pi * walked_m / 17.0 + phase_x),
        y_m=y_m + 0.35 * np.sin(2.0 * np.pi * walked_m / 13.0 + phase_y),
        storey=storey,
        walked_m=walked_m,
        floor_changes=tuple(changes),
    )
