"""Known beacons: scans at surveyed points, by lateration, centroid and fingerprints."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import TypeAlias

import numpy as np

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.lateration.centroid import CentroidParams, weighted_centroid
from app.core.params import LaterationParams, MatchParams
from app.core.radio.beacon_places import BeaconPlacesParams
from app.core.radio.local_mean import local_means_dbm
from app.core.radio.path_loss import LevelModel
from app.core.radio.windows import window_of
from app.core.site import Wall
from app.core.types import Anchor, Fix, FloatArray
from app.formats.uji_ble import FLOOR, PointScan
from app.services.evaluation.beacons import (
    LATERATION,
    MIN_ANCHORS,
    UNKNOWN_PHONE,
    Place,
    PlaceError,
    Surroundings,
    carefully_surveyed,
    laterated,
    matched,
    placed,
    ratios_to_mean,
    surveyed,
)
from app.services.evaluation.figures import Evaluation, Figures, error_figures

PROTOCOL = (
    "per phone and transmit power: anchors calibrated on the scans at half of the points, asked at "
    "the other half (geo: odd and even min(k, 69 - k), since points k and 69 - k share their "
    "place; elsewhere odd and even points); only scans with at least 3 beacons are asked; one "
    "scan, and all scans of a point together; errors pooled over phones and powers; methods and "
    "parameters of lateration were compared within the first half only, every fourth of its places "
    "asked with what the others calibrate; lateration knows the plan's shelves and pillars, and "
    "what a side of them takes is fitted in the first half; lateration_without_plan does not; "
    "lateration_10_db_off: 10 dB added to and taken off all levels, of which lateration is not "
    "told; calibrated_on_half and calibrated_on_all: as POST /v1/floors/{id}/calibration fits, "
    "without plan, on the first half and on all points; worst_beacon_ratio: largest ratio, over "
    "beacons and powers, of the rms residual at the second half to that of the floor's mean model; "
    "estimated_places: lateration with beacons whose places were estimated on the first half"
)
UNKNOWN_OFFSETS_DB = (-10.0, 10.0)

Locate: TypeAlias = Callable[[Sequence[PointScan], float], Place | None]
"""Where a phone is that made these scans, with this much added to its levels (dB)."""


def evaluate(
    anchors: Sequence[Anchor], obstacles: Sequence[Wall], scans: Sequence[PointScan], zone: str
) -> Evaluation:
    """Return the figures of every method."""
    errors: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    told = _Beacons()
    for trained, asked in _splits(scans, zone):
        methods = _methods(anchors, trained, obstacles)
        methods |= _calibrations(anchors, trained, asked, told)
        for name, (locate, offsets_db) in methods.items():
            for offset_db in offsets_db:
                one = ([scan] for scan in asked)
                errors[name]["one"] += _errors_m(locate, one, offset_db)
                errors[name]["mean"] += _errors_m(locate, _by_point(asked), offset_db)
    few_share = _few_share(scans, zone)
    of_beacons: dict[str, Figures] = {
        "calibrated_on_half": {"worst_beacon_ratio": max(told.ratios)},
        "estimated_places": told.place_figures(),
    }
    figures = {
        name: {**_figures(found, few_share), **of_beacons.get(name, {})}
        for name, found in errors.items()
    }
    return Evaluation(
        dataset=f"uji-ble {zone}",
        command=f"pharos evaluate uji-ble DIR --zone {zone}",
        protocol=PROTOCOL,
        profiles=figures,
    )


@dataclass(slots=True)
class _Beacons:
    """What calibration and placing tell of the beacons themselves, over phones and powers."""

    ratios: list[float] = field(default_factory=list)
    places: list[PlaceError] = field(default_factory=list)

    def place_figures(self) -> Figures:
        """Return how far estimated places are from the true ones."""
        errors_m = [place.error_m for place in self.places]
        return {
            "place_mean_error_m": float(np.mean(errors_m)),
            "place_median_error_m": float(np.median(errors_m)),
            "place_coverage95": float(np.mean([place.is_inside95 for place in self.places])),
        }


def _few_share(scans: Sequence[PointScan], zone: str) -> float:
    few = sum(_beacons(scan) < MIN_ANCHORS for _, asked in _splits(scans, zone) for scan in asked)
    total = sum(len(asked) for _, asked in _splits(scans, zone))
    return few / total


def _figures(found: dict[str, list[float]], few_share: float) -> Figures:
    return {
        "samples": len(found["one"]),
        **error_figures(found["one"]),
        "too_few_beacons_share": few_share,
        "point_mean": {"samples": len(found["mean"]), **error_figures(found["mean"])},
    }


def _splits(
    scans: Sequence[PointScan], zone: str
) -> Iterable[tuple[list[PointScan], list[PointScan]]]:
    """Yield the scans to calibrate with and those to ask, per phone and power."""

    def is_trained(scan: PointScan) -> bool:
        number = min(scan.point, 69 - scan.point) if zone == "geo" else scan.point
        return number % 2 == 1

    def kind(scan: PointScan) -> tuple[str, int]:
        return scan.phone, scan.tx_power_dbm

    for _, grouped in groupby(sorted(scans, key=kind), key=kind):
        of_kind = list(grouped)
        trained = [scan for scan in of_kind if is_trained(scan)]
        yield trained, [scan for scan in of_kind if not is_trained(scan)]


def _by_point(scans: Iterable[PointScan]) -> list[list[PointScan]]:
    points: dict[tuple[str, int], list[PointScan]] = defaultdict(list)
    for scan in scans:
        points[scan.campaign, scan.point].append(scan)
    return list(points.values())


def _beacons(scan: PointScan) -> int:
    return len({level.anchor_id for level in scan.levels})


def _errors_m(
    locate: Locate, groups: Iterable[Sequence[PointScan]], offset_db: float
) -> list[float]:
    errors_m: list[float] = []
    for scans in groups:
        heard = len({level.anchor_id for scan in scans for level in scan.levels})
        place = locate(scans, offset_db) if heard >= MIN_ANCHORS else None
        if place is not None:
            truth = scans[0]
            errors_m.append(float(np.hypot(place[0] - truth.x_m, place[1] - truth.y_m)))
    return errors_m


def _methods(
    anchors: Sequence[Anchor], trained: Sequence[PointScan], obstacles: Sequence[Wall]
) -> dict[str, tuple[Locate, tuple[float, ...]]]:
    index = {anchor.anchor_id: i for i, anchor in enumerate(anchors)}
    heard = _heard(index, trained)
    open_plan, with_plan = surveyed(anchors, heard), surveyed(anchors, heard, obstacles)
    as_calibrated = (0.0,)
    return {
        "lateration": (_lateration(index, with_plan, LATERATION), as_calibrated),
        "lateration_10_db_off": (_lateration(index, with_plan, UNKNOWN_PHONE), UNKNOWN_OFFSETS_DB),
        "lateration_without_plan": (_lateration(index, open_plan, LATERATION), as_calibrated),
        "weighted_centroid": (_centroid(index, open_plan.model), as_calibrated),
        "fingerprint": (_fingerprint(trained), as_calibrated),
    }


def _calibrations(
    anchors: Sequence[Anchor],
    trained: Sequence[PointScan],
    asked: Sequence[PointScan],
    told: _Beacons,
) -> dict[str, tuple[Locate, tuple[float, ...]]]:
    """Return lateration with calibrations as the server makes them; note what they tell."""
    index = {anchor.anchor_id: i for i, anchor in enumerate(anchors)}
    heard, others = _heard(index, trained), _heard(index, asked)
    told.ratios += ratios_to_mean(anchors, heard, others)
    params = BeaconPlacesParams()
    estimated, errors = placed(anchors, heard, params.height_m, params)
    told.places += errors
    estimated_index = {anchor.anchor_id: i for i, anchor in enumerate(estimated.anchors)}
    half = carefully_surveyed(anchors, heard)
    every = carefully_surveyed(anchors, np.vstack([heard, others]))
    as_calibrated = (0.0,)
    return {
        "calibrated_on_half": (_lateration(index, half, LATERATION), as_calibrated),
        "calibrated_on_all": (_lateration(index, every, LATERATION), as_calibrated),
        "estimated_places": (_lateration(estimated_index, estimated, LATERATION), as_calibrated),
    }


def _heard(index: dict[str, int], scans: Sequence[PointScan]) -> FloatArray:
    """Return anchor, x, y and local mean level (n, 4) of each anchor at each point."""
    return np.array(
        [
            (index[anchor_id], of_point[0].x_m, of_point[0].y_m, level_dbm)
            for of_point in _by_point(scans)
            for anchor_id, level_dbm in _local_means(of_point).items()
        ]
    )


def _lateration(index: dict[str, int], among: Surroundings, params: LaterationParams) -> Locate:
    def locate(scans: Sequence[PointScan], offset_db: float) -> Place | None:
        return laterated(window_of(*_readings(scans, index, offset_db)), among, params)

    return locate


def _centroid(index: dict[str, int], model: LevelModel) -> Locate:
    def locate(scans: Sequence[PointScan], offset_db: float) -> Place | None:
        window = window_of(*_readings(scans, index, offset_db))
        found = weighted_centroid(window, model, 0.0, CentroidParams())
        return (found.x_m, found.y_m) if isinstance(found, Fix) else None

    return locate


def _fingerprint(trained: Sequence[PointScan]) -> Locate:
    fingerprints = [
        Fingerprint(0, s.x_m, s.y_m, {}, _mean_levels([s], 0.0)) for s in trained if s.levels
    ]
    radio_map, params = build_radio_map([FLOOR], fingerprints), MatchParams()

    def locate(scans: Sequence[PointScan], offset_db: float) -> Place | None:
        return matched(_mean_levels(scans, offset_db), radio_map, params)

    return locate


def _readings(
    scans: Iterable[PointScan], index: dict[str, int], offset_db: float
) -> tuple[np.ndarray, FloatArray, FloatArray]:
    rows = np.array(
        [
            (index[level.anchor_id], level.time_s, level.rssi_dbm + offset_db)
            for scan in scans
            for level in scan.levels
            if level.anchor_id in index
        ]
    ).reshape(-1, 3)
    return rows[:, 0].astype(np.int64), rows[:, 1], rows[:, 2]


def _local_means(scans: Sequence[PointScan]) -> dict[str, float]:
    """Return the local mean of each anchor at a point: shadowing errs alike in all its scans."""
    levels = [level for scan in scans for level in scan.levels]
    anchor_ids, group = np.unique([level.anchor_id for level in levels], return_inverse=True)
    rssi_dbm = np.array([level.rssi_dbm for level in levels])
    means_dbm = local_means_dbm(group, rssi_dbm, len(anchor_ids))
    return dict(zip(anchor_ids.tolist(), means_dbm.tolist(), strict=True))


def _mean_levels(scans: Iterable[PointScan], offset_db: float) -> dict[str, float]:
    levels: dict[str, list[float]] = defaultdict(list)
    for scan in scans:
        for level in scan.levels:
            levels[level.anchor_id].append(level.rssi_dbm + offset_db)
    return {anchor_id: float(np.mean(heard)) for anchor_id, heard in levels.items()}
