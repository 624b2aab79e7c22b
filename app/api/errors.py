"""RFC 9457 problem+json: the one JSON shape of every refused request under ``/v1``."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from uuid import uuid4

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from app.services.errors import AppError, ErrorCode, FieldError, unavailable
from app.storage.database import DatabaseUnavailableError

__all__ = ["STATUS", "AppError", "ErrorCode", "FieldError", "install_handlers", "problem"]

_LOG = logging.getLogger(__name__)

STATUS: dict[ErrorCode, int] = {
    ErrorCode.MALFORMED_BODY: 400,
    ErrorCode.MALFORMED_GZIP: 400,
    ErrorCode.INVALID_CURSOR: 400,
    ErrorCode.TOKEN_MISSING: 401,
    ErrorCode.TOKEN_INVALID: 401,
    ErrorCode.TOKEN_EXPIRED: 401,
    ErrorCode.ROLE_FORBIDDEN: 403,
    ErrorCode.SITE_FORBIDDEN: 403,
    ErrorCode.DEVICE_FORBIDDEN: 403,
    ErrorCode.ORIGIN_FORBIDDEN: 403,
    ErrorCode.NOT_FOUND: 404,
    ErrorCode.METHOD_NOT_ALLOWED: 405,
    ErrorCode.NOT_ACCEPTABLE: 406,
    ErrorCode.CONFLICT: 409,
    ErrorCode.IN_USE: 409,
    ErrorCode.SEQ_CONFLICT: 409,
    ErrorCode.CLOCK_CHANGED: 409,
    ErrorCode.SESSION_OVER: 409,
    ErrorCode.NO_GEOREFERENCE: 409,
    ErrorCode.ETAG_MISMATCH: 412,
    ErrorCode.BODY_TOO_LARGE: 413,
    ErrorCode.MEDIA_TYPE_UNSUPPORTED: 415,
    ErrorCode.CODING_UNSUPPORTED: 415,
    ErrorCode.INVALID_FIELD: 422,
    ErrorCode.SITE_REQUIRED: 422,
    ErrorCode.TOO_MANY_REQUESTS: 429,
    ErrorCode.INTERNAL: 500,
    ErrorCode.UNAVAILABLE: 503,
}

# What Starlette and FastAPI raise themselves carries a status only.
_CODE_OF_STATUS: dict[int, ErrorCode] = {
    400: ErrorCode.MALFORMED_BODY,
    401: ErrorCode.TOKEN_MISSING,
    403: ErrorCode.ROLE_FORBIDDEN,
    404: ErrorCode.NOT_FOUND,
    405: ErrorCode.METHOD_NOT_ALLOWED,
    406: ErrorCode.NOT_ACCEPTABLE,
    413: ErrorCode.BODY_TOO_LARGE,
    415: ErrorCode.MEDIA_TYPE_UNSUPPORTED,
}

MEDIA_TYPE = "application/problem+json"


def problem(error: AppError, instance: str = "", request_id: str = "") -> dict[str, Any]:
    """Return the problem document of an error; sockets send it inside a frame."""
    status = STATUS[error.code]
    document: dict[str, Any] = {
        "type": f"urn:pharos:problem:{error.code}",
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": error.detail,
        "code": error.code.value,
    }
    if instance:
        document["instance"] = instance
    if error.errors:
        document["errors"] = [{"pointer": e.pointer, "detail": e.detail} for e in error.errors]
    if request_id:
        document["request_id"] = request_id
    return document


def request_id_of(request: Request) -> str:
    """Return the id that names this request in replies and logs."""
    return getattr(request.state, "request_id", "") or uuid4().hex


def install_handlers(app: FastAPI) -> None:
    """Make every error of ``app`` answer with a problem document."""
    app.add_exception_handler(AppError, _on_app_error)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(DatabaseUnavailableError, _on_outage)
    app.add_exception_handler(Exception, _on_unexpected)


def respond(request: Request, error: AppError) -> JSONResponse:
    """Return the response of an error."""
    headers = dict(error.headers)
    if STATUS[error.code] == HTTPStatus.UNAUTHORIZED:
        headers.setdefault("WWW-Authenticate", 'Bearer realm="pharos"')
    if error.retry_after_s is not None:
        headers["Retry-After"] = str(error.retry_after_s)
    return JSONResponse(
        problem(error, request.url.path, request_id_of(request)),
        status_code=STATUS[error.code],
        headers=headers,
        media_type=MEDIA_TYPE,
    )


def log_outage(what: str, error: AppError) -> None:
    """Log why ``what`` could not be stored or read now; who asked is told to come back, no more."""
    if error.code is ErrorCode.UNAVAILABLE and error.__cause__ is not None:
        _LOG.warning("%s: %s: %s", what, error.detail, error.__cause__)


@contextmanager
def pointing_to_query() -> Iterator[None]:
    """Name, in what is refused inside, parameters of the query in place of fields of the body.

    Services know one name for what may come in a body or in the query.
    """
    try:
        yield
    except AppError as error:
        error.errors = tuple(
            FieldError(e.pointer.replace("#/", "query:", 1), e.detail) for e in error.errors
        )
        raise


def field_errors(errors: Sequence[Any]) -> tuple[FieldError, ...]:
    """Return pydantic's validation errors as pointers into the body or names of parameters."""
    return tuple(FieldError(_pointer(e["loc"]), e["msg"]) for e in errors)


def _pointer(loc: Sequence[str | int]) -> str:
    where, *rest = loc
    path = "".join(f"/{str(part).replace('~', '~0').replace('/', '~1')}" for part in rest)
    # An unknown field's name may hold half a surrogate pair, which no reply can.
    path = path.encode(errors="replace").decode()
    return f"#{path}" if where == "body" else f"{where}:{path.lstrip('/')}"


async def _on_app_error(request: Request, exc: Exception) -> JSONResponse:
    assert isinstance(exc, AppError)  # noqa: S101 - registered for this class
    log_outage(f"request {request_id_of(request)}", exc)
    return respond(request, exc)


async def _on_validation_error(request: Request, exc: Exception) -> JSONResponse:
    assert isinstance(exc, RequestValidationError)  # noqa: S101 - registered for this class
    errors = exc.errors()
    malformed = any(e["type"] == "json_invalid" for e in errors)
    code = ErrorCode.MALFORMED_BODY if malformed else ErrorCode.INVALID_FIELD
    detail = "the body is not JSON" if malformed else "the request has fields that are not valid"
    return respond(request, AppError(code, detail, errors=field_errors(errors)))


async def _on_http_exception(request: Request, exc: Exception) -> JSONResponse:
    assert isinstance(exc, HTTPException)  # noqa: S101 - registered for this class
    code = _CODE_OF_STATUS.get(exc.status_code, ErrorCode.INTERNAL)
    return respond(request, AppError(code, str(exc.detail), headers=dict(exc.headers or {})))


async def _on_outage(request: Request, exc: Exception) -> JSONResponse:
    _LOG.warning("request %s: the database does not answer: %s", request_id_of(request), exc)
    return respond(request, unavailable())


async def _on_unexpected(request: Request, exc: Exception) -> JSONResponse:
    _LOG.error("request %s failed", request_id_of(request), exc_info=exc)
    return respond(request, AppError(ErrorCode.INTERNAL, "the server failed; its log says why"))
