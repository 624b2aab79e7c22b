"""Browsers' login: a token for an HttpOnly cookie that only our own pages can use."""

from typing import Annotated

from fastapi import Body, Depends, Request, Response
from pydantic import BaseModel, Field

from app.api.auth import COOKIE, Principal, require
from app.api.context import context_of
from app.api.openapi_problems import problems
from app.api.resource import registry_router

router = registry_router("/v1", "access")


class LoginBody(BaseModel):
    """A token to log in with."""

    token: str = Field(max_length=200)


class WhoAmI(BaseModel):
    """Who is logged in."""

    role: str
    site_id: str | None
    device_id: str | None


@router.post("/login", responses=problems(401, 503))
async def log_in(
    request: Request, response: Response, body: Annotated[LoginBody, Body()]
) -> WhoAmI:
    """Check a token and keep it as the browser's cookie."""
    context = context_of(request)
    principal = await context.authenticator.principal(body.token.strip())
    response.set_cookie(
        COOKIE,
        body.token.strip(),
        max_age=round(context.login_s),
        httponly=True,
        samesite="strict",
        secure=context.cookie_secure or request.url.scheme == "https",
    )
    return _who(principal)


@router.get("/login")
async def show_login(principal: Annotated[Principal, Depends(require())]) -> WhoAmI:
    """Tell who is asking."""
    return _who(principal)


@router.delete("/login", status_code=204)
async def log_out(response: Response) -> None:
    """Forget the cookie."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")


def _who(principal: Principal) -> WhoAmI:
    return WhoAmI(
        role=principal.role.value, site_id=principal.site_id, device_id=principal.device_id
    )
