"""``/v1/calibrations`` and the two requests of a floor that draft one."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from fastapi import Query, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import AfterValidator, BaseModel, Field, ValidationError, model_validator

from app.api.auth import Principal, check_site
from app.api.conditional import NOT_MODIFIED, Seen, is_held, not_modified
from app.api.context import ApiContext
from app.api.fix import iso_time
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Metres,
    Reader,
    Reference,
    StrictModel,
    created,
    listed_site,
    registry_router,
    tagged,
)
from app.api.uploads import json_of, media_type_of, read_bounded
from app.formats.ms2020 import parse_trace
from app.formats.transmitters import canonical_key
from app.services import calibration_drafts as drafts
from app.services import calibration_sources as sources
from app.services.calibration_sources import Labelled, LabelledLevel
from app.services.errors import AppError, ErrorCode, found
from app.storage import calibrations, floors
from app.storage.calibrations import StoredCalibration
from app.storage.floors import StoredFloor

router = registry_router("/v1/calibrations", "calibration")
floor_router = registry_router("/v1/floors", "calibration")

MAX_SOURCE_BYTES = 32 << 20
"""A trace of an hour, or some 400 000 levels."""

TRACE_TYPE = "text/plain"


class Level(StrictModel):
    """One level heard at a known place; `beacon_id` or `key` says whose."""

    x: Metres
    y: Metres
    rssi_dbm: Annotated[float, Field(ge=-127, le=20)]
    beacon_id: Reference | None = None
    key: Annotated[str, Field(max_length=100), AfterValidator(canonical_key)] | None = None
    device_id: Annotated[str, Field(max_length=64)] = ""

    @model_validator(mode="after")
    def _names_one(self) -> Self:
        if (self.beacon_id is None) == (self.key is None):
            msg = "either beacon_id or key is needed"
            raise ValueError(msg)
        return self


class SessionOf(StrictModel):
    """A session with `truth` records; `session` left out: the device's newest."""

    device_id: Reference
    session: Reference | None = None


class Source(StrictModel):
    """Where the labelled levels are: one of the three."""

    levels: Annotated[list[Level], Field(min_length=1, max_length=500_000)] | None = None
    session: SessionOf | None = None
    survey_id: Reference | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if [self.levels, self.session, self.survey_id].count(None) != 2:
            msg = "one of levels, session and survey_id is needed"
            raise ValueError(msg)
        return self


class PlacesSource(Source):
    """Where the labelled levels are, and which beacons to place.

    `beacon_ids` left out: all registered beacons without a place. With `register_unknown` the BLE
    transmitters heard that nobody has registered are placed, too, and added when it is applied.
    """

    beacon_ids: Annotated[list[Reference], Field(min_length=1, max_length=10_000)] | None = None
    register_unknown: bool = False


class Calibration(BaseModel):
    """A calibration: `state` is `draft` until it is applied."""

    calibration_id: str
    site_id: str
    floor_id: str
    kind: Literal["levels", "places"]
    state: Literal["draft", "applied"]
    created: str
    applied: str | None
    source: dict[str, Any]
    report: dict[str, Any]


SOURCE_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {"schema": {"type": "object"}},
            TRACE_TYPE: {"schema": {"type": "string"}},
        },
    }
}


class TraceOptions(BaseModel):
    """What a recorded trace does not say itself; JSON bodies do, and ignore these."""

    device_id: str = Field("", max_length=64, description="Phone that recorded the trace")
    register_unknown: bool = Field(False, description="Place beacons that are not registered, too")


@floor_router.post("/{floor_id}/calibration", status_code=201, openapi_extra=SOURCE_BODY)
async def calibrate_floor(
    floor_id: str,
    principal: Admin,
    context: Context,
    request: Request,
    response: Response,
    trace: Annotated[TraceOptions, Query()],
) -> Calibration:
    """Fit the level models of a floor's beacons and phones' offsets; nothing is changed yet.

    The body is JSON with `levels`, `session` or `survey_id`, or a recorded trace with waypoints
    (`text/plain`, the lines that `pharos import ms2020` reads).
    """
    floor = await _floor(context, principal, floor_id)
    asked = await _asked(request, Source)
    labelled = await _labelled(context, floor, asked, trace.device_id)
    stored = await drafts.draft_levels(
        context.database, context.plans, floor, labelled, context.clock.now_s()
    )
    return _created(response, stored)


@floor_router.post("/{floor_id}/beacon-places", status_code=201, openapi_extra=SOURCE_BODY)
async def place_beacons(
    floor_id: str,
    principal: Admin,
    context: Context,
    request: Request,
    response: Response,
    trace: Annotated[TraceOptions, Query()],
) -> Calibration:
    """Estimate where beacons are that have no place, with covariance; nothing is changed yet.

    The body is as for `calibration`; the query's `register_unknown` is for a trace.
    """
    floor = await _floor(context, principal, floor_id)
    asked = await _asked(request, PlacesSource)
    labelled = await _labelled(context, floor, asked, trace.device_id)
    which = drafts.PlacesRequest(None, trace.register_unknown)
    if isinstance(asked, PlacesSource):
        ids = None if asked.beacon_ids is None else tuple(asked.beacon_ids)
        which = drafts.PlacesRequest(ids, asked.register_unknown)
    stored = await drafts.draft_places(
        context.database, context.plans, floor, labelled, which, context.clock.now_s()
    )
    return _created(response, stored)


@router.get("")
async def list_calibrations(
    principal: Reader, context: Context, paging: Paging, site_id: str | None = None
) -> Page[Calibration]:
    """List calibrations by id, drafts and applied ones."""
    site = listed_site(principal, site_id)
    rows = await context.database.read(
        lambda c: calibrations.list_calibrations(
            c, site_id=site, after=paging.after, limit=paging.limit
        )
    )
    return page_of(rows, paging.limit, lambda row: row.calibration_id, _view)


@router.get("/{calibration_id}", response_model=Calibration, responses=NOT_MODIFIED)
async def get_calibration(
    calibration_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Calibration | Response:
    """Return one calibration with its report."""
    stored = await _calibration(context, principal, calibration_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(stored))


@router.post("/{calibration_id}/apply")
async def apply_calibration(
    calibration_id: str, principal: Admin, context: Context, seen: Seen, response: Response
) -> Calibration:
    """Put a draft's values into the registry, all or none; live sessions go on with them.

    It is refused (412) if one of its beacons was changed since the draft was made.
    """
    await _calibration(context, principal, calibration_id)
    stored = await drafts.apply_calibration(
        context.database, calibration_id, seen, context.clock.now_s()
    )
    for device_id in stored.offsets_db:
        context.ingest.forget(device_id)
    await context.directory.refresh()
    return tagged(response, stored.row_version, _view(stored))


@router.delete("/{calibration_id}", status_code=204)
async def discard_calibration(
    calibration_id: str, principal: Admin, context: Context, seen: Seen
) -> None:
    """Discard a draft, or forget an applied one; the registry stays as it is."""
    await _calibration(context, principal, calibration_id)
    await drafts.discard_calibration(context.database, calibration_id, seen)


async def _floor(context: ApiContext, principal: Principal, floor_id: str) -> StoredFloor:
    floor = found(
        await context.database.read(lambda c: floors.get_floor(c, floor_id)), "floor", floor_id
    )
    check_site(principal, floor.site_id)
    return floor


async def _calibration(
    context: ApiContext, principal: Principal, calibration_id: str
) -> StoredCalibration:
    stored = found(
        await context.database.read(lambda c: calibrations.get_calibration(c, calibration_id)),
        "calibration",
        calibration_id,
    )
    check_site(principal, stored.site_id)
    return stored


async def _asked(request: Request, model: type[Source]) -> Source | str:
    """Return the body: a source named in JSON, or the text of a trace."""
    media_type = media_type_of(request)
    if media_type not in {"application/json", TRACE_TYPE}:
        detail = f"the body is application/json, or a trace as {TRACE_TYPE}"
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, detail)
    body = await read_bounded(request, MAX_SOURCE_BYTES)
    if media_type == TRACE_TYPE:
        return body.decode("utf-8", "replace")
    try:
        return model.model_validate(json_of(body))
    except ValidationError as error:
        errors = [{**e, "loc": ("body", *e["loc"])} for e in error.errors()]
        raise RequestValidationError(errors) from error


async def _labelled(
    context: ApiContext, floor: StoredFloor, asked: Source | str, device_id: str
) -> Labelled:
    if isinstance(asked, str):
        try:
            trace = parse_trace("trace", floor.name, asked)
        except ValueError as error:
            raise AppError(ErrorCode.MALFORMED_BODY, str(error)) from error
        return sources.traced(trace, floor, device_id)
    if asked.survey_id is not None:
        return await sources.of_survey(context.database, floor.site_id, asked.survey_id)
    if asked.session is not None:
        named = asked.session
        return await sources.of_session(
            context.database, floor.site_id, named.device_id, named.session
        )
    return sources.listed([_level(level) for level in asked.levels or ()])


def _level(level: Level) -> LabelledLevel:
    return LabelledLevel(
        level.x, level.y, level.rssi_dbm, level.beacon_id or "", level.key or "", level.device_id
    )


def _created(response: Response, stored: StoredCalibration) -> Calibration:
    path = f"/v1/calibrations/{stored.calibration_id}"
    return created(response, path, stored.row_version, _view(stored))


def _view(stored: StoredCalibration) -> Calibration:
    report: Mapping[str, Any] = stored.report
    return Calibration.model_validate(
        {
            "calibration_id": stored.calibration_id,
            "site_id": stored.site_id,
            "floor_id": stored.floor_id,
            "kind": stored.kind,
            "state": "draft" if stored.applied_s is None else "applied",
            "created": iso_time(stored.created_s),
            "applied": None if stored.applied_s is None else iso_time(stored.applied_s),
            "source": dict(stored.source),
            "report": dict(report),
        }
    )
