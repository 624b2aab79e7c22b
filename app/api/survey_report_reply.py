"""A survey report as the reply to a request: JSON, or the page with its pictures."""

import asyncio
from importlib.util import find_spec
from typing import Any

import msgspec
from fastapi import Request, Response

from app.api.negotiation import best_type
from app.api.survey_report_formats import report_html
from app.services.errors import AppError, ErrorCode
from app.services.survey_reports import Reported

JSON, HTML = "application/json", "text/html"
REPORT_REPLIES: dict[int | str, dict[str, Any]] = {
    200: {"content": {JSON: {"schema": {"type": "object"}}, HTML: {}}}
}


def report_type(request: Request) -> str:
    """Return the media type to answer in; 406 for a page that this server cannot draw."""
    media_type = best_type(request, (JSON, HTML))
    if media_type == HTML and find_spec("matplotlib") is None:
        detail = "the page needs matplotlib: install pharos[plots] on the server, or ask for JSON"
        raise AppError(ErrorCode.NOT_ACCEPTABLE, detail)
    return media_type


async def report_reply(media_type: str, document: dict[str, Any], reported: Reported) -> Response:
    """Return the report in that type."""
    headers = {"Vary": "Accept"}
    if media_type == JSON:
        return Response(msgspec.json.encode(document), 200, headers, JSON)
    from app.api.survey_report_picture import floor_pictures  # noqa: PLC0415 - it needs an extra

    pictures = await asyncio.to_thread(floor_pictures, reported)
    return Response(report_html(document, pictures), 200, headers, HTML)
