"""Conditional requests (RFC 9110) and merge-patch (RFC 7396): no edit of what was not seen."""

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Header, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

from app.api.uploads import media_type_of, read_json_object
from app.services.errors import AppError, ErrorCode
from app.services.writing import SeenVersions

Model = TypeVar("Model", bound=BaseModel)

MAX_PATCH_BYTES = 1 << 20
PATCH_TYPES = ("application/merge-patch+json", "application/json")

NOT_MODIFIED: dict[int | str, dict[str, Any]] = {
    304: {"description": "If-None-Match names the state that there is."}
}
"""OpenAPI responses of a GET that `is_held` may answer."""


def etag_of(row_version: int | str) -> str:
    """Return the strong entity tag of a row version or of a content hash."""
    return f'"{row_version}"'


def _listed(header: str) -> frozenset[str]:
    return frozenset(part.strip() for part in header.split(","))


def seen_versions(
    if_match: Annotated[
        str | None, Header(description="ETag of the state that the edit was made on")
    ] = None,
) -> SeenVersions:
    """Return the row versions that If-Match names; None if any will do."""
    if if_match is None or if_match.strip() == "*":
        return None
    # Strong comparison: a weak tag matches nothing.
    return frozenset(etag.strip('"') for etag in _listed(if_match) if etag.startswith('"'))


Seen = Annotated[SeenVersions, Depends(seen_versions)]


def is_held(request: Request, row_version: int | str) -> bool:
    """Tell whether If-None-Match names this state: the client has it already."""
    header = request.headers.get("if-none-match")
    if header is None:
        return False
    held = {etag.removeprefix("W/") for etag in _listed(header)}
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
    if media_type_of(request) not in PATCH_TYPES:
        detail = f"PATCH takes {PATCH_TYPES[0]}"
        raise AppError(ErrorCode.MEDIA_TYPE_UNSUPPORTED, detail)
    return await read_json_object(request, MAX_PATCH_BYTES)


MergePatch = Annotated[dict[str, Any], Depends(read_merge_patch)]


def patch_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the OpenAPI of a PATCH whose body `read_merge_patch` reads itself."""
    schema = model.model_json_schema()
    schema.pop("required", None)
    return {"requestBody": {"required": True, "content": {PATCH_TYPES[0]: {"schema": schema}}}}


def patched(current: Model, patch: Mapping[str, Any], *place: str | int) -> Model:
    """Return the fields after a merge-patch; errors answer like those of a request body.

    ``place`` is where in the body the patch is.
    """
    document = apply_merge_patch(current.model_dump(mode="json"), patch)
    try:
        return type(current).model_validate(document)
    except ValidationError as error:
        errors = [{**e, "loc": ("body", *place, *e["loc"])} for e in error.errors()]
        raise RequestValidationError(errors) from error
