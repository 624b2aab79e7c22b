"""Conditional requests (RFC 9110) and merge-patch (RFC 7396): no edit of what was not seen."""

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from fastapi import Header, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from app.services.errors import AppError, ErrorCode

Model = TypeVar("Model", bound=BaseModel)

IfMatch = Annotated[str | None, Header(description="ETag of the state that the edit was made on")]
IfNoneMatch = Annotated[str | None, Header(description="ETag of the state already held")]

PATCH_TYPES = frozenset({"application/merge-patch+json", "application/json"})


def etag_of(row_version: int | str) -> str:
    """Return the strong entity tag of a row version or of a content hash."""
    return f'"{row_version}"'


def _listed(header: str) -> set[str]:
    return {part.strip() for part in header.split(",")}


def check_if_match(if_match: str | None, row_version: int | str) -> None:
    """Refuse an edit that was made on another state than the stored one."""
    if if_match is None or if_match.strip() == "*":
        return
    if etag_of(row_version) not in _listed(if_match):
        detail = "it was changed meanwhile; read it again"
        raise AppError(ErrorCode.ETAG_MISMATCH, detail, headers={"ETag": etag_of(row_version)})


def is_unchanged(if_none_match: str | None, row_version: int | str) -> bool:
    """Tell whether the client already holds this state (weak comparison)."""
    if if_none_match is None:
        return False
    held = {tag.removeprefix("W/") for tag in _listed(if_none_match)}
    return "*" in held or etag_of(row_version) in held


def not_modified(row_version: int | str) -> Response:
    """Return 304 with the entity tag."""
    return Response(status_code=304, headers={"ETag": etag_of(row_version)})


def apply_merge_patch(target: object, patch: object) -> object:
    """Return ``target`` patched: null removes, objects merge, all else replaces."""
    if not isinstance(patch, Mapping):
        return patch
    merged = dict(target) if isinstance(target, Mapping) else {}
    for key, value in patch.items():
        if value is None:
            merged.pop(key, None)
        else:
            merged[key] = apply_merge_patch(merged.get(key), value)
    return merged


async def read_merge_patch(request: Request) -> dict[str, Any]:
    """Return the request's merge-patch document, which must be an object."""
    content_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if content_type not in PATCH_TYPES:
        detail = "PATCH takes application/merge-patch+json"
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, detail)
    try:
        patch = await request.json()
    except ValueError as error:
        raise AppError(ErrorCode.MALFORMED_BODY, "the body is not JSON") from error
    if not isinstance(patch, dict):
        raise AppError(ErrorCode.MALFORMED_BODY, "a merge-patch is a JSON object")
    return patch


def validated(model: type[Model], document: Mapping[str, Any]) -> Model:
    """Return the document as ``model``; its errors answer like those of a request body."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        errors = [{**e, "loc": ("body", *e["loc"])} for e in error.errors()]
        raise RequestValidationError(errors) from error
