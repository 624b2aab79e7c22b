"""``POST /v1/locate``: a scan in, a fix and its alternatives out; nothing is stored."""

from typing import Annotated

import msgspec
from fastapi import APIRouter, Depends, Request, Response

from app.api.auth import Principal, require
from app.api.body import read_json_body
from app.api.context import context_of
from app.api.fix import output_json
from app.api.ingest_decode import decode_body, decode_records, rejection_json
from app.api.ingest_openapi import LOCATE_BODY, LOCATE_REPLY
from app.api.ingest_schema import LocateBody
from app.services.errors import invalid_field
from app.services.locate import locate
from app.services.site_choice import choose_params, choose_site

router = APIRouter(prefix="/v1", tags=["ingest"])

_QUESTIONS = msgspec.json.Decoder(LocateBody)


@router.post("/locate", openapi_extra=LOCATE_BODY, responses={200: LOCATE_REPLY})
async def post_locate(
    request: Request, principal: Annotated[Principal, Depends(require())]
) -> Response:
    """Tell where records that belong together were heard."""
    context = context_of(request)
    body = decode_body(await read_json_body(request, context.limits), _QUESTIONS)
    site = choose_site(context.directory, principal, body.site)
    params = choose_params(context.directory, site.site_id, body.profile)
    records = decode_records(body.records, may_state_truth=False)
    if len({record.monotonic for record in records.accepted}) > 1:
        raise invalid_field(pointer="#/records", detail="use t_ms or mono_ms, not both")
    located = await locate(site, params, (record.observation for record in records.accepted))
    georeference = context.directory.georeference(site.site_id)
    reply = {
        **output_json(None, site.site_id, located.output, georeference),
        "alternatives": [
            {"floor_id": a.floor_id, "x": a.x_m, "y": a.y_m, "weight": a.weight}
            for a in located.alternatives
        ],
        "rejected": [rejection_json(r) for r in records.rejected],
        "ignored": records.ignored,
    }
    return Response(msgspec.json.encode(reply), media_type="application/json")
