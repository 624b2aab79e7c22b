"""What can go wrong with a request, as stable codes; the API gives each its HTTP status."""

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

Found = TypeVar("Found")


class ErrorCode(StrEnum):
    """Stable codes of refused requests; part of the API's contract (docs/api.md lists them)."""

    MALFORMED_BODY = "malformed_body"
    MALFORMED_GZIP = "malformed_gzip"
    INVALID_CURSOR = "invalid_cursor"
    TOKEN_MISSING = "token_missing"  # noqa: S105 - a code, not a secret
    TOKEN_INVALID = "token_invalid"  # noqa: S105
    TOKEN_EXPIRED = "token_expired"  # noqa: S105
    ROLE_FORBIDDEN = "role_forbidden"
    SITE_FORBIDDEN = "site_forbidden"
    DEVICE_FORBIDDEN = "device_forbidden"
    ORIGIN_FORBIDDEN = "origin_forbidden"
    NOT_FOUND = "not_found"
    METHOD_NOT_ALLOWED = "method_not_allowed"
    NOT_ACCEPTABLE = "not_acceptable"
    CONFLICT = "conflict"
    IN_USE = "in_use"
    SEQ_CONFLICT = "seq_conflict"
    CLOCK_CHANGED = "clock_changed"
    SESSION_OVER = "session_over"
    NO_GEOREFERENCE = "no_georeference"
    ETAG_MISMATCH = "etag_mismatch"
    BODY_TOO_LARGE = "body_too_large"
    MEDIA_TYPE_UNSUPPORTED = "media_type_unsupported"
    CODING_UNSUPPORTED = "coding_unsupported"
    INVALID_FIELD = "invalid_field"
    SITE_REQUIRED = "site_required"
    TOO_MANY_REQUESTS = "too_many_requests"
    INTERNAL = "internal"
    UNAVAILABLE = "unavailable"


@dataclass(frozen=True, slots=True)
class FieldError:
    """One wrong place of a body: a JSON pointer (``#/records/3/t_ms``) and words."""

    pointer: str
    detail: str


class AppError(Exception):
    """A request that is refused for a reason its sender can act on."""

    def __init__(
        self,
        code: ErrorCode,
        detail: str,
        *,
        errors: tuple[FieldError, ...] = (),
        retry_after_s: int | None = None,
        headers: dict[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.code = code
        self.detail = detail
        self.errors = errors
        self.retry_after_s = retry_after_s
        self.headers = headers or {}


def unavailable() -> AppError:
    """Return the error for a database that does not answer now."""
    detail = "the database does not answer; come back later"
    # An outage is seldom over within a second; a phone keeps a day of batches.
    return AppError(ErrorCode.UNAVAILABLE, detail, retry_after_s=5)


def not_found(what: str, identifier: str) -> AppError:
    """Return the error for something that does not exist."""
    return AppError(ErrorCode.NOT_FOUND, f"there is no {what} {identifier!r}")


def found(value: Found | None, what: str, identifier: str) -> Found:
    """Return ``value``; the error of `not_found` if it is None."""
    if value is None:
        raise not_found(what, identifier)
    return value


def invalid_field(pointer: str, detail: str) -> AppError:
    """Return the error for one field of a well-formed body that cannot be meant."""
    return AppError(ErrorCode.INVALID_FIELD, detail, errors=(FieldError(pointer, detail),))
