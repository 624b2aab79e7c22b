"""Which of several media types to answer in (RFC 9110, Accept)."""

from collections.abc import Sequence

from fastapi import Request

from app.services.errors import AppError, ErrorCode


def best_type(request: Request, offered: Sequence[str]) -> str:
    """Return the offered type that the client likes best; of equals, the first offered.

    Raises
    ------
    AppError
        406 if it accepts none of them.
    """
    ranges = _ranges(request.headers.get("accept") or "*/*")
    ranked = [(_quality(ranges, media_type), -i) for i, media_type in enumerate(offered)]
    quality, index = max(ranked)
    if quality <= 0:
        raise AppError(ErrorCode.NOT_ACCEPTABLE, f"offered are {', '.join(offered)}")
    return offered[-index]


def _ranges(accept: str) -> dict[str, float]:
    ranges = {}
    for part in accept.split(","):
        media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
        quality = [p.removeprefix("q=") for p in parameters if p.startswith("q=")]
        try:
            ranges[media_range] = float(quality[0]) if quality else 1.0
        except ValueError:
            ranges[media_range] = 0.0
    return ranges


def _quality(ranges: dict[str, float], media_type: str) -> float:
    for media_range in (media_type, f"{media_type.partition('/')[0]}/*", "*/*"):
        if media_range in ranges:
            return ranges[media_range]
    return 0.0
