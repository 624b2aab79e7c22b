"""Lists of bounded length with opaque cursors: ``{"items": [...], "next_cursor": ...}``."""

import base64
import binascii
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Generic, TypeVar

from fastapi import Depends, Query
from pydantic import BaseModel

from app.services.errors import AppError, ErrorCode

Item = TypeVar("Item")
Stored = TypeVar("Stored")

MAX_LIMIT = 500
"""A page of this many rows stays under 1 MB and a few milliseconds."""


@dataclass(frozen=True, slots=True)
class PageRequest:
    """Which page is asked for: how many rows, after which key."""

    limit: int
    after: str | None


class Page(BaseModel, Generic[Item]):
    """One page of a list; ``next_cursor`` is null on the last one."""

    items: list[Item]
    next_cursor: str | None = None


def encode_cursor(last_key: str) -> str:
    """Return the cursor that continues after the row with ``last_key``."""
    return base64.urlsafe_b64encode(last_key.encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> str:
    """Return the key to continue after."""
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        key = base64.b64decode(padded, altchars=b"-_", validate=True).decode()
    except (binascii.Error, UnicodeDecodeError, ValueError) as error:
        raise AppError(ErrorCode.INVALID_CURSOR, "the cursor is not one of ours") from error
    if "\x00" in key:
        raise AppError(ErrorCode.INVALID_CURSOR, "the cursor is not one of ours")
    return key


def page_request(
    limit: Annotated[int, Query(ge=1, le=MAX_LIMIT, description="Rows per page")] = 100,
    cursor: Annotated[
        str | None, Query(max_length=400, description="`next_cursor` of the page before; opaque")
    ] = None,
) -> PageRequest:
    """Return the page that a list's parameters ask for."""
    return PageRequest(limit, None if cursor is None else decode_cursor(cursor))


Paging = Annotated[PageRequest, Depends(page_request)]


def newest_first_cursor(created_s: float, identifier: str) -> str:
    """Return the key of a row of a list whose newest rows come first; a page ends with it."""
    return f"{created_s!r} {identifier}"


def newest_first_after(paging: PageRequest) -> tuple[float, str] | None:
    """Return when the last row of the page before was made, and its id."""
    if paging.after is None:
        return None
    created, _, identifier = paging.after.partition(" ")
    try:
        return float(created), identifier
    except ValueError as error:
        detail = "the cursor is not one of this list"
        raise AppError(ErrorCode.INVALID_CURSOR, detail) from error


def page_of(
    rows: Sequence[Stored],
    limit: int,
    key: Callable[[Stored], str],
    present: Callable[[Stored], Item],
) -> Page[Item]:
    """Return a page from up to ``limit + 1`` rows; a surplus row says that there is a next page."""
    more = len(rows) > limit
    kept = rows[:limit]
    cursor = encode_cursor(key(kept[-1])) if more else None
    return Page(items=[present(row) for row in kept], next_cursor=cursor)
