"""The file of a ``multipart/form-data`` body, as it streams in; fields beside it are refused.

Only what a form with one file field sends is understood (RFC 7578).
"""

import re
from collections.abc import AsyncIterable, AsyncIterator

from app.services.errors import AppError, ErrorCode

_MAX_HEAD_BYTES = 16 << 10
_BOUNDARY = re.compile(r'boundary=(?:"([^"]{1,70})"|([^\s;"]{1,70}))', re.IGNORECASE)
_FILE = re.compile(rb"^content-disposition:.*\bfilename\*?=", re.IGNORECASE | re.MULTILINE)


def boundary_of(content_type: str) -> bytes | None:
    """Return the boundary of a multipart body; None if the body is not multipart."""
    if not content_type.lower().startswith("multipart/"):
        return None
    match = _BOUNDARY.search(content_type)
    if match is None:
        raise AppError(ErrorCode.MALFORMED_BODY, "the multipart body names no boundary")
    return (match[1] or match[2]).encode("latin-1")


async def file_part(chunks: AsyncIterable[bytes], boundary: bytes) -> AsyncIterator[bytes]:
    """Yield the bytes of the body's one file.

    Raises
    ------
    AppError
        400 if the body does not begin with a file, or breaks off before its end.
    """
    pieces = aiter(chunks)
    buffer = await _after_head(pieces, b"--" + boundary)
    end = b"\r\n--" + boundary
    while (found := buffer.find(end)) < 0:
        # The last bytes may be the beginning of the boundary.
        ready = max(len(buffer) - len(end) + 1, 0)
        if ready:
            yield bytes(buffer[:ready])
            del buffer[:ready]
        fresh = await anext(pieces, None)
        if fresh is None:
            raise AppError(ErrorCode.MALFORMED_BODY, "the multipart body broke off")
        buffer += fresh
    yield bytes(buffer[:found])
    async for _ in pieces:
        # Read to the end: a client that still sends would not see the reply.
        continue


async def _after_head(pieces: AsyncIterator[bytes], delimiter: bytes) -> bytearray:
    buffer = bytearray()
    while (end := buffer.find(b"\r\n\r\n")) < 0:
        fresh = await anext(pieces, None)
        if fresh is None or len(buffer) > _MAX_HEAD_BYTES:
            raise AppError(ErrorCode.MALFORMED_BODY, "the multipart body has no part")
        buffer += fresh
    head = bytes(buffer[:end])
    if not head.lstrip(b"\r\n").startswith(delimiter) or not _FILE.search(head):
        detail = "the first part of a multipart body has to be the file"
        raise AppError(ErrorCode.MALFORMED_BODY, detail)
    del buffer[: end + 4]
    return buffer
