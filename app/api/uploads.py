"""Uploaded bodies: of bounded size, and a picture that is what it says it is."""

import io
import re
from typing import Any

import msgspec
from fastapi import Request
from PIL import Image, UnidentifiedImageError

from app.services.errors import AppError, ErrorCode
from app.storage.floors import PlanImage

MAX_PLAN_BYTES = 20 << 20
MAX_PLAN_PIXELS = 64_000_000
"""Decoded, a plan of this size takes 256 MB in a browser; larger ones are scanned posters."""

_FORMATS = {"image/png": "PNG", "image/jpeg": "JPEG"}
PLAN_TYPES = (*_FORMATS, "image/svg+xml")
_SVG_START = re.compile(
    rb"^\s*(<\?xml[^>]*\?>\s*)?((<!--.*?-->|<!DOCTYPE[^>]*>)\s*)*<svg[\s>]", re.DOTALL
)


async def read_json_object(request: Request, max_bytes: int) -> dict[str, Any]:
    """Return the JSON object in the request's body."""
    media_type = media_type_of(request)
    if media_type != "application/json" and not media_type.endswith("+json"):
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, "the body must be application/json")
    document = json_of(await read_bounded(request, max_bytes))
    if not isinstance(document, dict):
        raise AppError(ErrorCode.MALFORMED_BODY, "the body is not a JSON object")
    return document


def json_of(body: bytes) -> Any:  # noqa: ANN401 - whatever JSON is in it
    """Return the document of a JSON body.

    Strictly: what the standard library lets pass (NaN, half a surrogate pair) could be stored, but
    neither PostgreSQL nor a reply can hold it.
    """
    try:
        return msgspec.json.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise AppError(ErrorCode.MALFORMED_BODY, f"the body is not JSON: {error}") from error


def media_type_of(request: Request) -> str:
    """Return the media type of the request's body, without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


async def read_bounded(request: Request, max_bytes: int) -> bytes:
    """Return the request's body; 413 as soon as it is larger than ``max_bytes``."""
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > max_bytes:
            detail = f"the body is larger than {max_bytes >> 20} MB"
            raise AppError(ErrorCode.BODY_TOO_LARGE, detail)
    return bytes(body)


async def read_plan_image(request: Request) -> PlanImage:
    """Return the picture in the request's body."""
    media_type = media_type_of(request)
    if media_type not in PLAN_TYPES:
        detail = f"a plan is one of {', '.join(PLAN_TYPES)}"
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, detail)
    image = await read_bounded(request, MAX_PLAN_BYTES)
    if media_type in _FORMATS:
        _check_raster(image, _FORMATS[media_type])
    elif not _SVG_START.match(image.removeprefix(b"\xef\xbb\xbf")):
        raise AppError(ErrorCode.MALFORMED_BODY, "the body is not an SVG drawing")
    return PlanImage(media_type, image)


def _check_raster(image: bytes, expected: str) -> None:
    try:
        with Image.open(io.BytesIO(image), formats=[expected]) as opened:
            width, height = opened.size
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise AppError(ErrorCode.MALFORMED_BODY, f"the body is not a {expected}") from error
    if width * height > MAX_PLAN_PIXELS:
        detail = f"a plan has at most {MAX_PLAN_PIXELS // 1_000_000} million pixels"
        raise AppError(ErrorCode.BODY_TOO_LARGE, detail)
