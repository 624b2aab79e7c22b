"""Request bodies as they stream in: bounded while they arrive, gzip opened piece by piece."""

import zlib
from collections.abc import AsyncIterator
from typing import NoReturn

from starlette.requests import ClientDisconnect, Request

from app.api.context import ApiLimits
from app.services.errors import AppError, ErrorCode

_GZIP = 16 + zlib.MAX_WBITS
# A short body of equal records may shrink by any ratio and harms nobody.
_RATIO_COUNTS_FROM_BYTES = 1 << 16


async def read_json_body(request: Request, limits: ApiLimits) -> bytes:
    """Return a JSON body, decompressed.

    Raises
    ------
    AppError
        415 for another media type or coding, 413 beyond the limits, 400 for broken gzip.
    """
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json" and not media_type.endswith("+json"):
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, "the body must be application/json")
    chunks = _bounded(request, limits.max_body_bytes)
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if coding in {"gzip", "x-gzip"}:
        chunks = _gunzip(chunks, limits)
    elif coding != "identity":
        raise AppError(
            ErrorCode.CODING_UNSUPPORTED,
            f"content coding {coding!r} is not known here",
            headers={"Accept-Encoding": "gzip, identity"},
        )
    return b"".join([chunk async for chunk in chunks])


async def _bounded(request: Request, limit: int) -> AsyncIterator[bytes]:
    announced = request.headers.get("content-length", "0")
    if announced.isdecimal() and int(announced) > limit:
        _refuse(f"the body is longer than {limit} bytes")
    seen = 0
    try:
        async for chunk in request.stream():
            seen += len(chunk)
            if seen > limit:
                _refuse(f"the body is longer than {limit} bytes")
            yield chunk
    except ClientDisconnect as error:
        raise AppError(ErrorCode.MALFORMED_BODY, "the body broke off") from error


async def _gunzip(chunks: AsyncIterator[bytes], limits: ApiLimits) -> AsyncIterator[bytes]:
    unpacker = zlib.decompressobj(_GZIP)
    sent = decoded = 0
    try:
        async for chunk in chunks:
            sent += len(chunk)
            packed = chunk
            while packed:
                if unpacker.eof:
                    unpacker = zlib.decompressobj(_GZIP)
                piece = unpacker.decompress(packed, limits.max_decoded_bytes - decoded + 1)
                decoded += len(piece)
                _check_size(sent, decoded, limits)
                yield piece
                packed = unpacker.unconsumed_tail or unpacker.unused_data
    except zlib.error as error:
        raise AppError(ErrorCode.MALFORMED_GZIP, "the body is not gzip") from error
    if not unpacker.eof:
        raise AppError(ErrorCode.MALFORMED_GZIP, "the gzip body is cut off")


def _check_size(sent: int, decoded: int, limits: ApiLimits) -> None:
    if decoded > limits.max_decoded_bytes:
        _refuse(f"the decompressed body is longer than {limits.max_decoded_bytes} bytes")
    if decoded > max(_RATIO_COUNTS_FROM_BYTES, limits.max_gzip_ratio * sent):
        _refuse(f"the body grows more than {limits.max_gzip_ratio} times")


def _refuse(detail: str) -> NoReturn:
    raise AppError(ErrorCode.BODY_TOO_LARGE, detail)
