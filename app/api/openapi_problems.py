"""Which problems each operation of the OpenAPI document may answer with, by its own shape."""

from collections.abc import Iterator
from typing import Any

from app.services.errors import ErrorCode

Schema = dict[str, Any]

_TEXT: Schema = {"type": "string"}

PROBLEM: Schema = {
    "type": "object",
    "description": "RFC 9457 problem details.",
    "properties": {
        "type": _TEXT,
        "title": _TEXT,
        "status": {"type": "integer"},
        "detail": _TEXT,
        "instance": _TEXT,
        "code": {"enum": [code.value for code in ErrorCode]},
        "errors": {
            "type": "array",
            "items": {"type": "object", "properties": {"pointer": _TEXT, "detail": _TEXT}},
        },
        "request_id": _TEXT,
    },
    "required": ["type", "title", "status", "detail", "code"],
}

_MEANING: dict[int, str] = {
    400: "The body or the cursor cannot be read.",
    401: "No valid token.",
    403: "Not with this token.",
    404: "There is no such thing.",
    406: "None of the media types asked for.",
    409: "It is taken, in use, or does not fit the state of things.",
    412: "Changed meanwhile: read again.",
    413: "Too large.",
    415: "Another media type or content coding than those taken.",
    422: "A field that cannot be meant; see `errors`.",
    429: "Too much is waiting; see Retry-After.",
    503: "The database does not answer; see Retry-After.",
}

_SAFE_METHODS = frozenset({"get", "head"})


def problems(*statuses: int) -> dict[int | str, Schema]:
    """Return the OpenAPI responses of some statuses."""
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {s: {"description": _MEANING[s], "content": content} for s in statuses}


def add_problems(document: Schema) -> None:
    """Add to every operation what it may be refused with, in place of FastAPI's own error shape."""
    for path in document["paths"].values():
        for method, operation in path.items():
            responses = operation["responses"]
            responses.pop("422", None)
            for status, response in problems(*sorted(set(_statuses(method, operation)))).items():
                responses.setdefault(str(status), response)
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)


def _statuses(method: str, operation: Schema) -> Iterator[int]:
    parameters = {parameter["name"] for parameter in operation.get("parameters", ())}
    success = next(iter(operation["responses"].values()))
    if operation.get("security") != []:
        yield from (401, 403, 503)
    if parameters or "requestBody" in operation:
        yield from (404, 422)
    if "cursor" in parameters:
        yield 400
    if len(success.get("content", ())) > 1:
        yield 406
    if "requestBody" in operation:
        yield from (400, 413, 415)
    if method not in _SAFE_METHODS and operation.get("security") != []:
        yield 409
    if "if-match" in parameters:
        yield 412
