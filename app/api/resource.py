"""What the routes of every registry resource share: strict fields, ids, dependencies, replies."""

import re
from collections.abc import Callable, Coroutine
from typing import Annotated, Any, TypeVar
from uuid import uuid4

from fastapi import APIRouter, Depends, HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic import AfterValidator, AwareDatetime, BaseModel, BeforeValidator, ConfigDict, Field
from starlette.types import Message, Receive

from app.api.auth import READERS, Principal, Role, check_site, require
from app.api.conditional import etag_of
from app.api.context import ApiContext, context_of
from app.services.errors import AppError, ErrorCode
from app.services.profiles import profile_names, unknown_profile

MAX_JSON_BYTES = 1 << 20

View = TypeVar("View", bound=BaseModel)

Context = Annotated[ApiContext, Depends(context_of)]
Reader = Annotated[Principal, Depends(require(*READERS))]
Admin = Annotated[Principal, Depends(require(Role.ADMIN))]

# PostgreSQL stores no NUL, and no name needs a control character.
PLAIN = r"^[^\x00-\x1f\x7f]*$"
Text = Annotated[str, Field(max_length=200, pattern=PLAIN)]
Name = Annotated[Text, Field(min_length=1)]
Reference = Annotated[str, Field(min_length=1, max_length=64, pattern=PLAIN)]
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


def _known_profile(name: str) -> str:
    if name not in profile_names():
        raise ValueError(unknown_profile(name))
    return name


def _has_date_and_time(text: str) -> str:
    if not re.match(r"\d{4}-\d{2}-\d{2}[Tt ]", text):
        msg = "an RFC 3339 time, as 2026-01-31T12:00:00Z"
        raise ValueError(msg)
    return text


Instant = Annotated[AwareDatetime, BeforeValidator(_has_date_and_time)]
ProfileName = Annotated[
    str,
    AfterValidator(_known_profile),
    Field(json_schema_extra=lambda schema: schema.update(enum=list(profile_names()))),
]
Metres = Annotated[float, Field(ge=-100_000, le=100_000)]


class StrictModel(BaseModel):
    """Fields that are exactly as documented: no others, no numbers in strings, all finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class RegistryRoute(APIRoute):
    """A route whose JSON body is bounded: FastAPI reads it before it looks at the token."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of requests."""
        handle = super().get_route_handler()
        reads_body = self.body_field is not None

        async def bounded(request: Request) -> Response:
            if "\x00" in request.scope["path"] or b"%00" in request.scope["query_string"]:
                raise AppError(ErrorCode.NOT_FOUND, "nothing has a NUL in its name")
            if reads_body:
                request = Request(request.scope, _bounded(request.receive, MAX_JSON_BYTES))
            return await handle(request)

        return bounded


def registry_router(prefix: str, *tags: str) -> APIRouter:
    """Return a router for one kind of resource."""
    return APIRouter(prefix=prefix, tags=list(tags), route_class=RegistryRoute)


def _bounded(receive: Receive, max_bytes: int) -> Receive:
    seen = 0

    async def bounded() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > max_bytes:
            # FastAPI lets only its own exceptions pass from here.
            raise HTTPException(413, f"the body is larger than {max_bytes >> 20} MB")
        return message

    return bounded


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
