"""What the routes of every registry resource share: strict fields, ids, dependencies, replies."""

from typing import Annotated, Any, TypeVar
from uuid import uuid4

from fastapi import Depends, Response
from pydantic import BaseModel, ConfigDict, Field

from app.api.auth import READERS, Principal, Role, check_site, require
from app.api.conditional import etag_of
from app.api.context import ApiContext, context_of

View = TypeVar("View", bound=BaseModel)

Context = Annotated[ApiContext, Depends(context_of)]
Reader = Annotated[Principal, Depends(require(*READERS))]
Admin = Annotated[Principal, Depends(require(Role.ADMIN))]

Name = Annotated[str, Field(min_length=1, max_length=200)]
Identifier = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="Chosen by you; made up if left out",
        default_factory=lambda: uuid4().hex[:12],
    ),
]
Metres = Annotated[float, Field(ge=-100_000, le=100_000)]


class StrictModel(BaseModel):
    """Fields that are exactly as documented: no others, no numbers in strings, all finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def listed_site(principal: Principal, site_id: str | None) -> str | None:
    """Return the site to list: the one asked for, or the one that the token is limited to."""
    if site_id is not None:
        check_site(principal, site_id)
        return site_id
    return principal.site_id


def tagged(response: Response, row_version: int | str, view: View) -> View:
    """Return ``view`` with its entity tag on the response."""
    response.headers["ETag"] = etag_of(row_version)
    return view


def created(response: Response, location: str, row_version: int | str, view: View) -> View:
    """Return ``view`` as a newly made resource: 201, where it is, its entity tag."""
    response.status_code = 201
    response.headers["Location"] = location
    return tagged(response, row_version, view)


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI of refusals with these statuses."""
    return {status: {"description": "Refused (problem+json)"} for status in statuses}
