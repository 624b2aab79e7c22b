"""``/v1/surveys``: what surveyors brought home; uploaded in any known format, listed, deleted."""

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from pydantic import BaseModel, Field
from starlette.requests import ClientDisconnect

from app.api.auth import Principal, Role, check_site, require
from app.api.conditional import (
    NOT_MODIFIED,
    MergePatch,
    Seen,
    is_held,
    not_modified,
    patch_schema,
    patched,
)
from app.api.errors import pointing_to_query
from app.api.fix import iso_time
from app.api.jobs import Job, job_view
from app.api.multipart import boundary_of, file_part
from app.api.paging import Page, Paging, newest_first_after, newest_first_cursor, page_of
from app.api.resource import (
    Context,
    Name,
    Reader,
    Reference,
    StrictModel,
    Text,
    listed_site,
    registry_router,
    tagged,
)
from app.api.survey_report_formats import survey_report_json
from app.api.survey_report_reply import REPORT_REPLIES, report_reply, report_type
from app.services import surveys as survey_service
from app.services.errors import AppError, ErrorCode, found
from app.services.survey_frames import UploadRequest
from app.services.survey_reports import report_of_survey
from app.services.survey_session import SessionSurvey
from app.services.writing import write
from app.storage import surveys
from app.storage.jobs import StoredJob
from app.storage.surveys import StoredSurvey

router = registry_router("/v1/surveys", "surveys")

Surveyor = Annotated[Principal, Depends(require(Role.SURVEYOR))]
BODY = {
    "requestBody": {
        "required": True,
        "description": "The file as it is, or as the one file of a form; plain, gzip, xz or zip.",
        "content": {
            media_type: {"schema": {"type": "string", "format": "binary"}}
            for media_type in ("application/octet-stream", "multipart/form-data")
        },
    }
}


class FloorHolding(BaseModel):
    """What a survey holds of one floor."""

    floor_id: str
    walks: int
    scans: int
    fingerprints: int
    transmitters: int
    first: str | None
    last: str | None


class Survey(BaseModel):
    """A stored survey; `unusable` counts, by reason, what of the upload was left out."""

    survey_id: str
    site_id: str
    name: str
    format: str
    device_id: str | None
    device_model: str | None
    created: str
    floors: list[FloorHolding]
    unusable: dict[str, Any] | None


class SurveyFields(StrictModel):
    """What may be changed of a survey."""

    name: Text


class UploadQuery(StrictModel):
    """What an upload is of; `floor_id` is the floor of all of it, whatever its records say."""

    site_id: Reference
    name: Text = ""
    floor_id: Reference | None = None


class NewUpload(UploadQuery):
    """An upload in pieces: also how long the file is."""

    total_bytes: Annotated[int, Field(gt=0)]


class FromSession(StrictModel):
    """A session whose app posted `truth` records; `session` left out: the newest."""

    device_id: Reference
    session: Name | None = None
    name: Text = ""


@router.post("", status_code=202, openapi_extra=BODY)
async def upload_survey(
    request: Request,
    response: Response,
    principal: Surveyor,
    context: Context,
    asked: Annotated[UploadQuery, Query()],
) -> Job:
    """Receive a survey in one go; a job then reads it."""
    check_site(principal, asked.site_id)
    wanted = UploadRequest(asked.site_id, asked.name, asked.floor_id)
    boundary = boundary_of(request.headers.get("content-type", ""))
    body = _body(request)
    pieces = body if boundary is None else file_part(body, boundary)
    with pointing_to_query():
        job = await context.uploads.receive(wanted, pieces)
    return _accepted(response, job, principal)


@router.post("/uploads", status_code=201)
async def begin_upload(
    body: NewUpload, response: Response, principal: Surveyor, context: Context
) -> Job:
    """Begin an upload in pieces, which can be continued after a broken connection."""
    check_site(principal, body.site_id)
    request = UploadRequest(body.site_id, body.name, body.floor_id, body.total_bytes)
    job = await context.uploads.begin(request)
    response.headers["Location"] = f"/v1/surveys/uploads/{job.job_id}"
    return job_view(job, principal)


@router.patch("/uploads/{job_id}", status_code=202, openapi_extra=BODY)
async def continue_upload(
    job_id: str,
    request: Request,
    response: Response,
    principal: Surveyor,
    context: Context,
    offset: Annotated[int, Query(ge=0, description="`received_bytes` of the job so far")],
) -> Job:
    """Send the next bytes of an upload; with the last one the job reads it."""
    check_site(principal, context.uploads.site_of(job_id))
    job = await context.uploads.append(job_id, offset, _body(request))
    return _accepted(response, job, principal)


@router.delete("/uploads/{job_id}", status_code=204)
async def give_up_upload(job_id: str, principal: Surveyor, context: Context) -> None:
    """Forget an upload that is not whole yet; its job fails."""
    check_site(principal, context.uploads.site_of(job_id))
    await context.uploads.give_up(job_id)


@router.post("/from-session", status_code=201)
async def survey_from_session(
    body: FromSession, response: Response, principal: Surveyor, context: Context
) -> Survey:
    """Take a session, with the places that its surveyor stated, as a survey."""
    asked = SessionSurvey(body.device_id, body.session, body.name)
    stored = await context.session_surveys.take(principal, asked)
    response.headers["Location"] = f"/v1/surveys/{stored.survey_id}"
    return _view(stored)


@router.get("")
async def list_surveys(
    principal: Reader, context: Context, paging: Paging, site_id: str | None = None
) -> Page[Survey]:
    """List surveys, the newest first."""
    site, after = listed_site(principal, site_id), newest_first_after(paging)
    rows = await context.database.read(
        lambda c: surveys.list_surveys(c, site_id=site, after=after, limit=paging.limit)
    )
    return page_of(rows, paging.limit, _key, _view)


@router.get("/{survey_id}", response_model=Survey, responses=NOT_MODIFIED)
async def get_survey(
    survey_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Survey | Response:
    """Return what a survey holds, and what of its upload could not be used."""
    stored = await _in_scope(survey_id, principal, context)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(stored))


@router.patch("/{survey_id}", openapi_extra=patch_schema(SurveyFields))
async def rename_survey(
    survey_id: str,
    patch: MergePatch,
    principal: Surveyor,
    context: Context,
    seen: Seen,
    response: Response,
) -> Survey:
    """Give a survey another name (merge-patch); radio maps that were built of it stay."""
    await _in_scope(survey_id, principal, context)
    stored = await survey_service.rename_survey(
        context.database,
        survey_id,
        seen,
        lambda name: patched(SurveyFields(name=name), patch).name,
    )
    return tagged(response, stored.row_version, _view(stored))


@router.get("/{survey_id}/report", response_class=Response, responses=REPORT_REPLIES)
async def get_survey_report(
    survey_id: str, principal: Reader, context: Context, request: Request
) -> Response:
    """Return, as JSON or as a page, how good the radio map would be that it alone makes."""
    media_type = report_type(request)
    await _in_scope(survey_id, principal, context)
    told = await context.database.read(lambda c: report_of_survey(c, survey_id))
    document = survey_report_json(told, context.clock.now_s())
    return await report_reply(media_type, document, told.reported)


@router.delete("/{survey_id}", status_code=204)
async def delete_survey(survey_id: str, principal: Surveyor, context: Context) -> None:
    """Remove a survey; radio maps that were built from it stay."""
    await _in_scope(survey_id, principal, context)
    gone = await write(context.database, lambda c: surveys.delete_survey(c, survey_id))
    found(gone or None, "survey", survey_id)


async def _in_scope(survey_id: str, principal: Principal, context: Context) -> StoredSurvey:
    stored = found(
        await context.database.read(lambda c: surveys.get_survey(c, survey_id)), "survey", survey_id
    )
    check_site(principal, stored.site_id)
    return stored


def _key(survey: StoredSurvey) -> str:
    return newest_first_cursor(survey.created_s, survey.survey_id)


def _accepted(response: Response, job: StoredJob, principal: Principal) -> Job:
    response.headers["Location"] = f"/v1/jobs/{job.job_id}"
    response.headers["Upload-Offset"] = str(job.progress["received_bytes"])
    return job_view(job, principal)


async def _body(request: Request) -> AsyncIterator[bytes]:
    try:
        async for chunk in request.stream():
            yield chunk
    except ClientDisconnect as error:
        raise AppError(ErrorCode.MALFORMED_BODY, "the body broke off") from error


def _view(survey: StoredSurvey) -> Survey:
    return Survey(
        survey_id=survey.survey_id,
        site_id=survey.site_id,
        name=survey.name,
        format=survey.survey_format,
        device_id=survey.device_id,
        device_model=survey.device_model,
        created=iso_time(survey.created_s),
        floors=[
            FloorHolding(
                floor_id=holding.floor_id,
                walks=holding.walks,
                scans=holding.scans,
                fingerprints=holding.fingerprints,
                transmitters=holding.transmitters,
                first=_iso(holding.first_s),
                last=_iso(holding.last_s),
            )
            for holding in survey.holdings
        ],
        unusable=survey.unusable,
    )


def _iso(time_s: float | None) -> str | None:
    return None if time_s is None else iso_time(time_s)
