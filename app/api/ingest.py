"""``POST /v1/ingest`` and ``WS /v1/ingest/stream``: batches in, the fixes they produced out."""

from contextlib import suppress
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, Depends, Request, Response, WebSocket, WebSocketDisconnect

from app.api.auth import Principal, Role, identify, require
from app.api.body import read_json_body
from app.api.context import ApiContext, context_of
from app.api.errors import AppError, log_outage, problem
from app.api.fix import output_json
from app.api.ingest_decode import decode_body, decode_records, rejection_json
from app.api.ingest_openapi import INGEST_BODY, INGEST_REPLY
from app.api.ingest_schema import Batch, PhoneClock
from app.api.openapi_problems import problems
from app.api.socket import admit, close_socket, next_text
from app.services.ingest import Upload
from app.sessions.batch import ClockReport, Submitted

POSTERS = (Role.DEVICE, Role.SURVEYOR)
_BATCHES = msgspec.json.Decoder(Batch)
SURVEYORS = frozenset({Role.SURVEYOR, Role.ADMIN})

router = APIRouter(prefix="/v1/ingest", tags=["ingest"])


class _Seq(msgspec.Struct):
    seq: int | None = None


_SEQS = msgspec.json.Decoder(_Seq)


@router.post("", openapi_extra=INGEST_BODY, responses={200: INGEST_REPLY, **problems(429)})
async def post_batch(
    request: Request, principal: Annotated[Principal, Depends(require(*POSTERS))]
) -> Response:
    """Take a batch of records; answer once it is durable, with the fix that it produced."""
    context = context_of(request)
    body = await read_json_body(request, context.limits)
    reply = await _take(context, principal, body)
    return Response(msgspec.json.encode(reply), media_type="application/json")


@router.websocket("/stream")
async def stream_batches(websocket: WebSocket) -> None:
    """Take batches as text frames, one after the other, and acknowledge each under its seq."""
    if await admit(websocket, *POSTERS) is None:
        return
    context = context_of(websocket)
    try:
        while True:
            frame = await next_text(websocket, context.limits.max_body_bytes)
            if frame is None:
                return
            # Asked again for every frame: a token may be revoked while its socket is open.
            principal = await identify(websocket)
            reply = await _answer(context, principal, frame.encode())
            await websocket.send_text(msgspec.json.encode(reply).decode())
    except AppError as refused:
        await close_socket(websocket, refused)
    except WebSocketDisconnect:
        return


async def _answer(context: ApiContext, principal: Principal, body: bytes) -> dict[str, Any]:
    """Return the frame that acknowledges or refuses one batch; never raises."""
    seq: int | None = None
    with suppress(AppError):
        seq = decode_body(body, _SEQS).seq
    try:
        return {"op": "ack", "seq": seq, **await _take(context, principal, body)}
    except AppError as refused:
        log_outage(f"batch {seq} of a socket", refused)
        document = problem(refused)
        if refused.retry_after_s is not None:
            document["retry_after_s"] = refused.retry_after_s
        return {"op": "error", "seq": seq, "problem": document}


async def _take(context: ApiContext, principal: Principal, body: bytes) -> dict[str, Any]:
    batch = decode_body(body, _BATCHES)
    records = decode_records(batch.records, may_state_truth=principal.role in SURVEYORS)
    upload = Upload(
        device_id=batch.device.id,
        platform=batch.device.platform,
        model=batch.device.model,
        session=batch.session,
        seq=batch.seq,
        digest=records.digest,
        clock=_clock_report(batch.clock),
        records=records.accepted,
        rejected=records.rejected,
        ignored=records.ignored,
        site_id=batch.site,
        profile=batch.profile,
    )
    site_id, submitted = await context.ingest.submit(principal, upload)
    output = output_json(
        batch.device.id, site_id, submitted.output, context.directory.georeference(site_id)
    )
    return _reply(submitted, output, context.clock.now_s())


def _clock_report(clock: PhoneClock) -> ClockReport:
    return ClockReport(
        recorded=clock.mode == "recorded",
        sent_s=None if clock.sent_ms is None else clock.sent_ms / 1000.0,
        mono_s=None if clock.mono_ms is None else clock.mono_ms / 1000.0,
        boot_id=clock.boot_id,
    )


def _reply(submitted: Submitted, output: dict[str, Any], now_s: float) -> dict[str, Any]:
    return {
        "accepted": submitted.accepted,
        "waiting": submitted.waiting,
        "rejected": [rejection_json(rejection) for rejection in submitted.rejected],
        "ignored": submitted.ignored,
        "duplicate": submitted.duplicate,
        **output,
        "server_ms": round(now_s * 1000.0),
    }
