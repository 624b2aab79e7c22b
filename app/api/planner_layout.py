"""From what a plan is asked with to the layout that the planner judges."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Any

from app.api.planner_schema import DraftBeacon, DraftWall, Layout, PlanFields
from app.core.lateration.predicted import Schedule
from app.core.radio.walls import HearingParams
from app.core.site import Wall
from app.core.types import Anchor
from app.formats.floor_map import DEFAULT_ATTENUATION_DB, MATERIALS_DB
from app.services.errors import invalid_field
from app.services.planning import Frame, PlanRequest, StoredLayout, Tasks


def request_of_layout(layout: Layout) -> PlanRequest:
    """Return the plan of a layout of its own."""
    frame = Frame(layout.x0_m, layout.y0_m, layout.width_m, layout.height_m, layout.cell_m)
    return _request(layout, frame, (_drafted_all(layout.beacons, layout), None, ()))


def request_of_floor(
    fields: PlanFields,
    drafts: Sequence[DraftBeacon] | None,
    frame: Frame,
    stored: StoredLayout,
) -> PlanRequest:
    """Return the plan of a registered floor, with drafted beacons in place of its own if given."""
    anchors, walkable, walls = stored
    if drafts is None:
        anchors = tuple(_conditioned(anchor, fields) for anchor in anchors)
    else:
        anchors = _drafted_all(drafts, fields)
    return _request(fields, frame, (anchors, walkable, walls))


def materials_of(fields: PlanFields) -> dict[str, float]:
    """Return what walls take by material: the usual losses, and those given over them."""
    return {**MATERIALS_DB, **(fields.materials or {})}


def _request(fields: PlanFields, frame: Frame, stored: StoredLayout) -> PlanRequest:
    anchors, walkable, walls = stored
    if fields.walls is not None:
        walls = _walls(fields.walls, materials_of(fields))
    reach_m = math.inf if fields.reach_m is None else fields.reach_m
    return PlanRequest(
        frame,
        anchors,
        _conditioned(_usual(anchors), fields),
        walls,
        walkable,
        Schedule(fields.epochs, fields.period_s),
        HearingParams(fields.hearing_threshold_dbm, reach_m),
        fields.phone_height_m,
        fields.min_beacons,
        fields.bound_m,
        Tasks(fields.drop_one, fields.add, fields.cover_m, kinematic=fields.model == "kinematic"),
    )


def _drafted_all(beacons: Sequence[DraftBeacon], fields: PlanFields) -> tuple[Anchor, ...]:
    anchors = tuple(_drafted(i, beacon, fields) for i, beacon in enumerate(beacons))
    seen: set[str] = set()
    for i, anchor in enumerate(anchors):
        if anchor.anchor_id in seen:
            detail = f"{anchor.anchor_id!r} is there twice"
            raise invalid_field(pointer=f"#/beacons/{i}/id", detail=detail)
        seen.add(anchor.anchor_id)
    return anchors


def _drafted(index: int, beacon: DraftBeacon, fields: PlanFields) -> Anchor:
    given: dict[str, Any] = {
        "z_m": beacon.z,
        "ref_level_dbm": beacon.ref_level_dbm,
        "path_loss_exponent": beacon.path_loss_exponent,
        "shadowing_db": beacon.noise_db,
    }
    anchor = Anchor(beacon.id or f"beacon-{index + 1}", (), "", beacon.x, beacon.y)
    return _with(_conditioned(anchor, fields), given)


def _conditioned(anchor: Anchor, fields: PlanFields) -> Anchor:
    """Return an anchor under the plan's conditions, which are for all of them."""
    given: dict[str, Any] = {
        "ref_level_dbm": fields.ref_level_dbm,
        "ref_distance_m": None if fields.ref_level_dbm is None else 1.0,
        "path_loss_exponent": fields.path_loss_exponent,
        "shadowing_db": fields.noise_db,
    }
    return _with(anchor, given)


def _with(anchor: Anchor, given: Mapping[str, Any]) -> Anchor:
    return replace(anchor, **{name: value for name, value in given.items() if value is not None})


def _usual(anchors: Sequence[Anchor]) -> Anchor:
    """Return a beacon like most of them; without any, one as they come out of the box."""
    if not anchors:
        return Anchor("new", (), "", 0.0, 0.0)
    return Anchor(
        "new",
        (),
        "",
        0.0,
        0.0,
        median(a.z_m for a in anchors),
        median(a.ref_level_dbm for a in anchors),
        median(a.ref_distance_m for a in anchors),
        median(a.path_loss_exponent for a in anchors),
        median(a.shadowing_db for a in anchors),
    )


def _walls(drafts: Sequence[DraftWall], materials_db: Mapping[str, float]) -> tuple[Wall, ...]:
    walls: list[Wall] = []
    for i, draft in enumerate(drafts):
        loss_db = _loss_db(f"#/walls/{i}/material", draft, materials_db)
        walls += [Wall(x0, y0, x1, y1, loss_db) for (x0, y0), (x1, y1) in pairwise(draft.line)]
    return tuple(walls)


def _loss_db(pointer: str, draft: DraftWall, materials_db: Mapping[str, float]) -> float:
    if draft.attenuation_db is not None:
        return draft.attenuation_db
    if draft.material is None:
        return DEFAULT_ATTENUATION_DB
    if draft.material not in materials_db:
        detail = f"{draft.material!r} is not one of {', '.join(materials_db)}"
        raise invalid_field(pointer=pointer, detail=detail)
    return materials_db[draft.material]
