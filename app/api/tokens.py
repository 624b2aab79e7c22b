"""``/v1/tokens``: who may use the API; the secret is shown once, when it is made."""

from typing import Annotated, Self

from fastapi import Response
from pydantic import AwareDatetime, Field, model_validator

from app.api.auth import Principal, Role
from app.api.context import ApiContext
from app.api.fix import iso_time
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Name,
    Reference,
    StrictModel,
    listed_site,
    registry_router,
)
from app.services import issue_tokens
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.issue_tokens import TokenGrant
from app.storage import tokens
from app.storage.tokens import StoredToken

router = registry_router("/v1/tokens", "access")

# A hundred years: far beyond every use, and long before the times that cannot be written in UTC.
_LONGEST_S = 100 * 365.25 * 86_400.0


class NewToken(StrictModel):
    """A token to make; the role `device`, and only it, needs `device_id` or `device_prefix`."""

    name: Name
    role: Annotated[Role, Field(strict=False)]
    site_id: Reference | None = Field(None, description="The one site it is for; null: all")
    device_id: Reference | None = None
    device_prefix: Reference | None = None
    expires: Annotated[AwareDatetime, Field(strict=False)] | None = None

    @model_validator(mode="after")
    def _scope_fits_role(self) -> Self:
        named = (self.device_id is not None) + (self.device_prefix is not None)
        if named != (1 if self.role is Role.DEVICE else 0):
            msg = "device_id or device_prefix is for the role device, which needs one of them"
            raise ValueError(msg)
        return self


class Token(StrictModel):
    """A token without its secret."""

    token_id: str
    name: str
    role: str
    site_id: str | None
    device_id: str | None
    device_prefix: str | None
    created: str
    expires: str | None
    revoked: str | None


class TokenWithSecret(Token):
    """A token just made; `token` is the bearer secret and is never shown again."""

    token: str


@router.get("")
async def list_tokens(principal: Admin, context: Context, paging: Paging) -> Page[Token]:
    """List tokens by id, revoked ones too."""
    site = listed_site(principal, None)
    rows = await context.database.read(
        lambda c: tokens.list_tokens(c, site_id=site, after=paging.after, limit=paging.limit)
    )
    return page_of(rows, paging.limit, lambda token: token.token_id, _view)


@router.post("", status_code=201)
async def create_token(
    body: NewToken, principal: Admin, context: Context, response: Response
) -> TokenWithSecret:
    """Make a token."""
    _check_scope(principal, body.site_id)
    now_s = context.clock.now_s()
    expires_s = None if body.expires is None else body.expires.timestamp()
    if expires_s is not None and not now_s < expires_s <= now_s + _LONGEST_S:
        detail = "it would have expired already, or is more than a hundred years ahead"
        raise invalid_field(pointer="#/expires", detail=detail)
    grant = TokenGrant(
        body.name, body.role, body.site_id, body.device_id, body.device_prefix, expires_s
    )
    secret, stored = await issue_tokens.issue_token(context.database, grant, now_s)
    context.authenticator.forget()
    response.headers["Location"] = f"/v1/tokens/{stored.token_id}"
    response.headers["Cache-Control"] = "no-store"
    return TokenWithSecret(**_view(stored).model_dump(), token=secret)


@router.get("/{token_id}")
async def get_token(token_id: str, principal: Admin, context: Context) -> Token:
    """Return one token, without its secret."""
    return _view(await _token(context, principal, token_id))


@router.delete("/{token_id}", status_code=204)
async def revoke_token(token_id: str, principal: Admin, context: Context) -> None:
    """Revoke a token for good."""
    await _token(context, principal, token_id)
    await issue_tokens.revoke(context.database, token_id, context.clock.now_s())
    context.authenticator.forget()


async def _token(context: ApiContext, principal: Principal, token_id: str) -> StoredToken:
    stored = found(
        await context.database.read(lambda c: tokens.get_token(c, token_id)), "token", token_id
    )
    _check_scope(principal, stored.site_id)
    return stored


def _check_scope(principal: Principal, site_id: str | None) -> None:
    """Keep an admin of one site to tokens of that site; one for all sites would be an escape."""
    if principal.site_id is not None and principal.site_id != site_id:
        detail = f"the token is only for site {principal.site_id!r}"
        raise AppError(ErrorCode.SITE_FORBIDDEN, detail)


def _view(token: StoredToken) -> Token:
    return Token(
        token_id=token.token_id,
        name=token.name,
        role=token.role,
        site_id=token.site_id,
        device_id=token.device_id,
        device_prefix=token.device_prefix,
        created=iso_time(token.created_s),
        expires=None if token.expires_s is None else iso_time(token.expires_s),
        revoked=None if token.revoked_s is None else iso_time(token.revoked_s),
    )
