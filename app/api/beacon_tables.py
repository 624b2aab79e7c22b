"""``/v1/beacons/import`` and ``/export``: the registry as a table, CSV or JSON."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field, ValidationError

from app.api.auth import check_site
from app.api.beacons import RENAMED, NewBeacon, beacon_view, stored_beacon
from app.api.negotiation import best_type
from app.api.resource import Admin, Context, Reader, registry_router
from app.api.uploads import json_of, media_type_of, read_bounded
from app.formats.beacons_csv import (
    MAX_ROWS,
    OPTIONAL,
    BeaconRow,
    BeaconTableError,
    read_beacons_csv,
    write_beacons_csv,
)
from app.services import beacons as beacon_service
from app.services.beacons import ImportPlan, TableRow
from app.services.errors import AppError, ErrorCode
from app.storage import beacons
from app.storage.beacon_health import health_of_site
from app.storage.beacons import StoredBeacon

router = registry_router("/v1/beacons", "beacons")

MAX_TABLE_BYTES = 20 << 20

MAX_CHANGES = 1000
"""More than an admin looks through."""

TOLD_BY_TRAFFIC = frozenset({"last_heard_at", "battery"})
"""Fields of an exported beacon that nobody edits: an import passes them over."""

PLACE = frozenset({"floor_id", "x", "y"})
"""They belong together: who says one of them says all."""

SiteParameter = Annotated[str, Query(description="Site of the table")]


class RefusedRow(BaseModel):
    """A row that was left out: ``line`` of the CSV, or place in the JSON list counted from 1."""

    line: int
    beacon_id: str | None
    detail: str


class BeaconChange(BaseModel):
    """A beacon that is added (``change`` holds every field) or changed (those that differ)."""

    beacon_id: str
    added: bool
    change: dict[str, tuple[Any, Any]] = Field(description="Per field: before and after")


class ImportReport(BaseModel):
    """What an import did, or with ``dry_run`` would do."""

    dry_run: bool
    created: int
    updated: int
    unchanged: int
    changes: list[BeaconChange] = Field(description=f"The first {MAX_CHANGES} of them")
    refused: list[RefusedRow]


@router.post(
    "/import",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "text/csv": {"schema": {"type": "string"}},
                "application/json": {
                    "schema": {"type": "object", "properties": {"items": {"type": "array"}}}
                },
            },
        }
    },
)
async def import_beacons(
    principal: Admin,
    context: Context,
    request: Request,
    site_id: SiteParameter,
    dry_run: bool = False,
) -> ImportReport:
    """Add and change beacons by their ids, from a CSV table or a JSON list as exported.

    Good rows are taken, refused ones are listed; nothing is removed. What the table has no column
    (or an item no field) for stays as it is stored; an empty cell is set back to what a new beacon
    has. With `dry_run` nothing is stored.
    """
    check_site(principal, site_id)
    rows = await _rows(request)
    taken, lines, refused = checked_rows(site_id, rows)
    plan = await beacon_service.import_beacons(context.database, site_id, taken, dry_run=dry_run)
    if not dry_run:
        await context.directory.refresh()
    refused += [
        RefusedRow(line=lines[r.index], beacon_id=taken[r.index].beacon.beacon_id, detail=r.detail)
        for r in plan.refused
    ]
    return ImportReport(
        dry_run=dry_run,
        created=len(plan.created),
        updated=len(plan.updated),
        unchanged=plan.unchanged,
        changes=beacon_changes(plan),
        refused=sorted(refused, key=lambda row: row.line),
    )


@router.get("/export", response_class=JSONResponse)
async def export_beacons(
    principal: Reader, context: Context, request: Request, site_id: SiteParameter
) -> Response:
    """Return all beacons of a site as JSON, or as CSV by Accept; both can be imported again.

    What traffic says of a beacon is in it too, and passed over by an import.
    """
    check_site(principal, site_id)
    media_type = best_type(request, ("application/json", "text/csv"))
    await context.watch.flush_for_reader()
    stored = await context.database.read(lambda c: beacons.beacons_of_site(c, site_id))
    health = await context.database.read(lambda c: health_of_site(c, site_id))
    items = [beacon_view(b, health.get(b.beacon_id)).model_dump() for b in stored]
    if media_type == "application/json":
        return JSONResponse({"items": items})
    disposition = {"Content-Disposition": 'attachment; filename="beacons.csv"'}
    return Response(write_beacons_csv(items), media_type="text/csv", headers=disposition)


def beacon_changes(plan: ImportPlan) -> list[BeaconChange]:
    """Return what an import changes, field by field."""
    added = [(None, beacon) for beacon in plan.created]
    changed = [(plan.before[beacon.beacon_id], beacon) for beacon in plan.updated]
    return [_change(before, after) for before, after in (*added, *changed)][:MAX_CHANGES]


def _change(before: StoredBeacon | None, after: StoredBeacon) -> BeaconChange:
    now = beacon_view(after).model_dump()
    was = dict.fromkeys(now) if before is None else beacon_view(before).model_dump()
    change = {name: (was[name], value) for name, value in now.items() if was[name] != value}
    return BeaconChange(beacon_id=after.beacon_id, added=before is None, change=change)


async def _rows(request: Request) -> list[BeaconRow]:
    media_type = media_type_of(request)
    if media_type not in {"text/csv", "application/json"}:
        detail = "a table of beacons is text/csv or application/json"
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, detail)
    body = await read_bounded(request, MAX_TABLE_BYTES)
    try:
        if media_type == "application/json":
            return _json_rows(json_of(body))
        return list(read_beacons_csv(body.decode("utf-8")))
    except (UnicodeDecodeError, BeaconTableError) as error:
        detail = f"the body is not a table of beacons: {error}"
        raise AppError(ErrorCode.MALFORMED_BODY, detail) from error


def _json_rows(document: object) -> list[BeaconRow]:
    items = document.get("items") if isinstance(document, dict) else document
    if not isinstance(items, list) or len(items) > MAX_ROWS:
        msg = f"not a list of at most {MAX_ROWS} beacons"
        raise BeaconTableError(msg)
    return [
        BeaconRow(place, item, unsaid=_unsaid(item))
        if isinstance(item, dict)
        else BeaconRow(place, {}, "not an object")
        for place, item in enumerate(items, 1)
    ]


def _unsaid(item: Mapping[str, Any]) -> frozenset[str]:
    place = frozenset() if PLACE & item.keys() else PLACE
    return (OPTIONAL - item.keys()) | place


def checked_rows(
    site_id: str, rows: Sequence[BeaconRow]
) -> tuple[list[TableRow], list[int], list[RefusedRow]]:
    """Return the beacons of a table with their lines, and the rows that cannot be meant."""
    taken: list[TableRow] = []
    lines: list[int] = []
    refused: list[RefusedRow] = []
    for row in rows:
        try:
            taken.append(_beacon(site_id, row))
            lines.append(row.line)
        except ValueError as error:
            name = row.fields.get("beacon_id")
            named = name if isinstance(name, str) else None
            refused.append(RefusedRow(line=row.line, beacon_id=named, detail=_words(error)))
    return taken, lines, refused


def _beacon(site_id: str, row: BeaconRow) -> TableRow:
    if row.error:
        raise ValueError(row.error)
    fields: Mapping[str, Any] = row.fields
    if "beacon_id" not in fields:
        msg = "beacon_id is missing"
        raise ValueError(msg)
    if fields.get("site_id", site_id) != site_id:
        msg = f"it is of site {fields['site_id']!r}"
        raise ValueError(msg)
    edited = {name: value for name, value in fields.items() if name not in TOLD_BY_TRAFFIC}
    beacon = NewBeacon.model_validate({**edited, "site_id": site_id})
    unsaid = frozenset(RENAMED.get(name, name) for name in row.unsaid)
    return TableRow(stored_beacon(site_id, beacon.beacon_id, beacon), unsaid)


def _words(error: ValueError) -> str:
    if not isinstance(error, ValidationError):
        return str(error)
    return "; ".join(f"{'.'.join(map(str, e['loc'])) or 'row'}: {e['msg']}" for e in error.errors())
