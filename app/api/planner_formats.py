"""A judged layout as JSON and as GeoJSON (RFC 7946); the latter needs a site on the globe."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from app.core.georeference import Georeference
from app.core.types import Anchor, FloatArray
from app.services.planning import CoverPlan, Figures, Frame, PlanRequest, PlanResult, Step


def plan_json(request: PlanRequest, result: PlanResult) -> dict[str, Any]:
    """Return figures and grids; null is an infinite error, and in `in_range` a cell off the floor.

    The first row of a grid is the one at the lowest y.
    """
    frame, told = request.frame, result.prediction
    rows, columns = result.inside.shape
    in_range = told.in_range
    return {
        "x0_m": frame.x0_m,
        "y0_m": frame.y0_m,
        "cell_m": frame.cell_m,
        "rows": rows,
        "columns": columns,
        "cells": len(in_range),
        "bound_m": request.bound_m,
        "beacons": [_beacon(anchor) for anchor in request.anchors],
        "static": {**_figures(result.static), "grid": _grid(result, told.static_m)},
        "kinematic": {**_figures(result.kinematic), "grid": _grid(result, told.kinematic_m)},
        "in_range": {
            "min": int(in_range.min()),
            "median": float(np.median(in_range)),
            "max": int(in_range.max()),
            "share_three_or_more": round(float(np.mean(in_range >= 3)), 4),
            "grid": _grid(result, in_range.astype(np.float64), digits=0),
        },
        "drop_one": None if result.dropped is None else [_step(s) for s in result.dropped],
        "add": None if result.added is None else [_step(s) for s in result.added],
        "cover": None if result.cover is None else _cover(result.cover),
    }


def plan_geojson(
    request: PlanRequest, result: PlanResult, georeference: Georeference
) -> dict[str, Any]:
    """Return a polygon for each cell of the floor, and a point for each beacon, old and new."""
    features = [*_cell_features(request.frame, result, georeference)]
    for kind, anchors in beacons_by_kind(request, result).items():
        features += [_beacon_feature(kind, anchor, georeference) for anchor in anchors]
    return {"type": "FeatureCollection", "features": features}


def beacons_by_kind(request: PlanRequest, result: PlanResult) -> dict[str, Sequence[Anchor]]:
    """Return the beacons of a plan: those of the layout, and what to add to it."""
    added = () if result.added is None else tuple(step.anchor for step in result.added)
    cover = () if result.cover is None else result.cover.anchors
    return {"beacon": request.anchors, "add": added, "cover": cover}


def scattered(result: PlanResult, of_cells: FloatArray) -> FloatArray:
    """Return values of the floor's cells in their places, (rows, columns); NaN off the floor."""
    grid = np.full(result.inside.shape, np.nan)
    grid[result.inside] = of_cells
    return grid


def _figures(figures: Figures) -> dict[str, float | None]:
    return {
        "min": _finite(figures.min_m),
        "median": _finite(figures.median_m),
        "max": _finite(figures.max_m),
        "share_below": round(figures.below_share, 4),
        "mean_variance_m2": _finite(figures.variance_m2),
    }


def _step(step: Step) -> dict[str, Any]:
    return {**_beacon(step.anchor), **_figures(step.figures)}


def _cover(cover: CoverPlan) -> dict[str, Any]:
    return {
        "bound_m": cover.figures.bound_m,
        "reached": cover.reached,
        "beacons": [_beacon(anchor) for anchor in cover.anchors],
        **_figures(cover.figures),
    }


def _beacon(anchor: Anchor) -> dict[str, Any]:
    return {"id": anchor.anchor_id, "x": round(anchor.x_m, 3), "y": round(anchor.y_m, 3)}


def _grid(
    result: PlanResult, of_cells: FloatArray, digits: int = 3
) -> list[list[float | int | None]]:
    rows = np.round(scattered(result, of_cells), digits).tolist()
    if digits == 0:
        return [[None if math.isnan(value) else int(value) for value in row] for row in rows]
    return [[value if math.isfinite(value) else None for value in row] for row in rows]


def _finite(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def _cell_features(
    frame: Frame, result: PlanResult, georeference: Georeference
) -> Iterator[dict[str, Any]]:
    told = result.prediction
    values = zip(
        told.static_m.tolist(), told.kinematic_m.tolist(), told.in_range.tolist(), strict=True
    )
    corners = _Corners(frame, georeference)
    places = np.argwhere(result.inside).tolist()
    for (row, column), (static_m, kinematic_m, in_range) in zip(places, values, strict=True):
        ring = [
            corners.lon_lat(row + up, column + right)
            for up, right in ((0, 0), (0, 1), (1, 1), (1, 0), (0, 0))
        ]
        properties = {
            "kind": "cell",
            "static_m": _finite(static_m),
            "kinematic_m": _finite(kinematic_m),
            "in_range": in_range,
        }
        yield _feature({"type": "Polygon", "coordinates": [ring]}, properties)


class _Corners:
    """Corners of cells on the globe; four cells share each."""

    def __init__(self, frame: Frame, georeference: Georeference) -> None:
        self._frame, self._georeference = frame, georeference
        self._known: dict[tuple[int, int], list[float]] = {}

    def lon_lat(self, row: int, column: int) -> list[float]:
        if (row, column) not in self._known:
            x_m = self._frame.x0_m + column * self._frame.cell_m
            y_m = self._frame.y0_m + row * self._frame.cell_m
            self._known[row, column] = _lon_lat(self._georeference, x_m, y_m)
        return self._known[row, column]


def _beacon_feature(kind: str, anchor: Anchor, georeference: Georeference) -> dict[str, Any]:
    place = _lon_lat(georeference, anchor.x_m, anchor.y_m)
    return _feature({"type": "Point", "coordinates": place}, {"kind": kind, "id": anchor.anchor_id})


def _lon_lat(georeference: Georeference, x_m: float, y_m: float) -> list[float]:
    lat_deg, lon_deg = georeference.to_wgs84(x_m, y_m)
    return [round(lon_deg, 8), round(lat_deg, 8)]


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}
