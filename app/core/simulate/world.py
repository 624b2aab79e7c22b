"""The warehouse with everything in it, and the walks of phones through it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.simulate.building import (
    HEIGHT_M,
    STOREYS,
    WIDTH_M,
    ConnectorKind,
    Segment,
    floors,
)
from app.core.simulate.phone import (
    LOSS_PROBABILITY,
    Phone,
    ble_scans,
    draw_phone,
    imu_blocks,
    steps,
    wifi_scans,
)
from app.core.simulate.radio import FADING_DB, Transmitters, transmitters
from app.core.simulate.routes import (
    Place,
    RouteGraph,
    WalkTruth,
    along,
    plan_walk,
    route_graph,
)
from app.core.site import SiteModel
from app.core.types import Anchor, BleScan, FloatArray, ImuBlock, Observation, Steps, WifiScan

SITE_ID = "warehouse"
IBEACON_UUID = "5f0c6a52-1f0e-4c0b-9a1d-6d2f3a7b9e10"
BEACON_GRID, ACCESS_POINT_GRID = (5, 5), (4, 3)
SURVEY_SPACING_M, SURVEY_SCANS = 2.0, 4
# At equal times motion comes before scans, as in the engine's order.
_RANK = {ImuBlock: 0, Steps: 1, BleScan: 2, WifiScan: 3}


@dataclass(frozen=True, slots=True, eq=False)
class Warehouse:
    """The simulated world of one seed.

    Attributes
    ----------
    site
        What a server would know: floors, registered beacons, the radio map of the survey.
    beacons, access_points
        What is really there; levels are drawn from these.
    """

    seed: int
    site: SiteModel
    beacons: Transmitters
    access_points: Transmitters
    graphs: dict[ConnectorKind, RouteGraph]

    def fingerprints(
        self, seed: int, spacing_m: float = SURVEY_SPACING_M
    ) -> tuple[Fingerprint, ...]:
        """Return a survey: one fingerprint every ``spacing_m`` along every aisle of both floors."""
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, seed, 1]))
        places = list(_survey_places(spacing_m))
        points = np.array([(p.x_m, p.y_m, p.floor_index) for p, _ in places], dtype=np.float64)
        wifi = survey_levels(self.access_points, points, rng)
        ble = survey_levels(self.beacons, points, rng)
        return tuple(
            Fingerprint(place.floor_index, place.x_m, place.y_m, wifi[i], ble[i], survey_walk)
            for i, (place, survey_walk) in enumerate(places)
        )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedWalk:
    """One phone's walk: what it reported, in event-time order, and where it really was.

    Attributes
    ----------
    part
        How many walks of the same phone went before it.
    """

    phone: Phone
    part: int
    observations: tuple[Observation, ...]
    truth: WalkTruth

    def truth_at(self, time_s: float) -> Place:
        """Return where the phone was at a time."""
        return self.truth.at(time_s)


def warehouse(seed: int) -> Warehouse:
    """Return the simulated warehouse of a seed, surveyed along all of its aisles."""
    placing, ble, wifi = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    bare = SiteModel(SITE_ID, 1, floors(SITE_ID))
    floor_ids = tuple(floor.floor_id for floor in bare.floors)
    graphs = {kind: route_graph(kind) for kind in ConnectorKind}
    graph = graphs[ConnectorKind.STAIRS]
    beacons = transmitters(_beacons(floor_ids, graph, placing), bare.floors, -96.0, ble)
    access_points = transmitters(
        _access_points(floor_ids, graph, placing), bare.floors, -92.0, wifi
    )
    unmapped = Warehouse(
        seed, replace(bare, anchors=beacons.anchors), beacons, access_points, graphs
    )
    radio_map = build_radio_map(floor_ids, unmapped.fingerprints(seed=0))
    return replace(unmapped, site=replace(unmapped.site, radio_map=radio_map))


def walk(
    world: Warehouse,
    seed: int,
    start_s: float,
    duration_s: float,
    *,
    imu: bool = False,
    after: SimulatedWalk | None = None,
) -> SimulatedWalk:
    """Return the walk of phone ``seed`` from event time ``start_s`` on.

    Parameters
    ----------
    imu
        Report inertial blocks (1 s at 50 Hz) instead of the phone's own step events.
    after
        The same phone's walk before this one; this one starts where that one ended. By default the
        walk starts anywhere.
    """
    begin = None if after is None else after.truth_at(float(after.truth.time_s[-1]))
    part = 0 if after is None else after.part + 1
    traits = np.random.default_rng([world.seed, seed])
    route, radio, motion = (
        np.random.default_rng(s) for s in np.random.SeedSequence([world.seed, seed, part]).spawn(3)
    )
    phone = draw_phone(traits)
    truth = plan_walk(world.graphs, route, round(start_s, 3), duration_s, begin)
    told = imu_blocks(phone, truth, motion) if imu else steps(phone, truth, motion)
    observations: list[Observation] = [
        *told,
        *ble_scans(phone, truth, world.beacons, radio),
        *wifi_scans(phone, truth, world.access_points, radio),
    ]
    observations.sort(key=lambda o: (o.time_s, _RANK[type(o)]))
    return SimulatedWalk(phone, part, tuple(observations), truth)


def _grid(
    shape: tuple[int, int], floor_index: int, graph: RouteGraph, rng: np.random.Generator
) -> Iterator[Place]:
    """Yield places over the aisles, spread like an installer would: a loose grid."""
    columns, rows = shape
    for row in range(rows):
        for column in range(columns):
            x_m = (column + 0.5 + rng.uniform(-0.15, 0.15)) * WIDTH_M / columns
            y_m = (row + 0.5 + rng.uniform(-0.15, 0.15)) * HEIGHT_M / rows
            yield graph.places[graph.nearest(Place(floor_index, x_m, y_m))]


def _beacons(
    floor_ids: tuple[str, ...], graph: RouteGraph, rng: np.random.Generator
) -> tuple[Anchor, ...]:
    return tuple(
        Anchor(
            anchor_id=f"beacon-{floor_index}-{i:02d}",
            keys=(
                f"mac:02be{floor_index:02x}{i:06x}",
                f"ibeacon:{IBEACON_UUID}:{floor_index + 1}:{i}",
            ),
            floor_id=floor_id,
            x_m=place.x_m,
            y_m=place.y_m,
            z_m=2.5,
            ref_level_dbm=round(float(rng.normal(-59.0, 2.0)), 1),
            path_loss_exponent=round(float(rng.uniform(1.8, 2.4)), 2),
            shadowing_db=4.0,
        )
        for floor_index, floor_id in enumerate(floor_ids)
        for i, place in enumerate(_grid(BEACON_GRID, floor_index, graph, rng))
    )


def _access_points(
    floor_ids: tuple[str, ...], graph: RouteGraph, rng: np.random.Generator
) -> tuple[Anchor, ...]:
    return tuple(
        Anchor(
            anchor_id=f"ap-{floor_index}-{i:02d}",
            keys=(f"mac:02a9{floor_index:02x}{i:06x}",),
            floor_id=floor_id,
            x_m=place.x_m,
            y_m=place.y_m,
            z_m=3.5,
            ref_level_dbm=round(float(rng.normal(-40.0, 2.0)), 1),
            path_loss_exponent=round(float(rng.uniform(2.2, 2.8)), 2),
            shadowing_db=4.0,
        )
        for floor_index, floor_id in enumerate(floor_ids)
        for i, place in enumerate(_grid(ACCESS_POINT_GRID, floor_index, graph, rng))
    )


def _survey_places(spacing_m: float) -> Iterator[tuple[Place, str]]:
    """Yield the places of the survey, each with the name of its walk (one per aisle)."""
    for floor_index, storey in enumerate(STOREYS):
        for i, aisle in enumerate(storey.aisles):
            for x_m, y_m in along(_as_floats(aisle), spacing_m):
                yield Place(floor_index, x_m, y_m), f"{storey.floor_id}-aisle-{i:02d}"


def _as_floats(segment: Segment) -> Segment:
    x0, y0, x1, y1 = segment
    return (float(x0), float(y0), float(x1), float(y1))


def survey_levels(
    radio: Transmitters, points: FloatArray, rng: np.random.Generator
) -> list[dict[str, float]]:
    """Return per point the mean level of what was heard in a few scans, by most specific key."""
    shape = (SURVEY_SCANS, len(points), len(radio.anchors))
    level_dbm = radio.mean_levels_dbm(points) + rng.normal(0.0, FADING_DB, shape)
    heard = (level_dbm >= radio.detection_dbm) & (rng.random(shape) >= LOSS_PROBABILITY)
    counts = heard.sum(axis=0)
    mean_dbm = np.where(heard, level_dbm, 0.0).sum(axis=0) / np.maximum(counts, 1)
    return [
        {radio.anchors[t].keys[0]: round(float(mean_dbm[p, t]), 1) for t in np.flatnonzero(row)}
        for p, row in enumerate(counts)
    ]
