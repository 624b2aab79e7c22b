"""Who asks: bearer header, browser cookie or WebSocket subprotocol, turned into a `Principal`.

A router says who may use a route with ``principal: Annotated[Principal, Depends(require(...))]``;
the admin role may use every route.
"""

from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from starlette.requests import HTTPConnection

from app.api.context import context_of
from app.services.access import READERS, Principal, Role
from app.services.errors import AppError, ErrorCode

__all__ = [
    "COOKIE",
    "READERS",
    "SUBPROTOCOL",
    "Principal",
    "Role",
    "check_device",
    "check_site",
    "identify",
    "require",
]

COOKIE = "pharos_token"
SUBPROTOCOL = "pharos.v1"
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})


def require(*roles: Role) -> Callable[[HTTPConnection], Awaitable[Principal]]:
    """Return the dependency that lets ``roles`` (and always admin) pass; none named: every role."""
    allowed = frozenset(roles or Role) | {Role.ADMIN}

    async def dependency(connection: HTTPConnection) -> Principal:
        principal = await identify(connection)
        if principal.role not in allowed:
            raise AppError(
                ErrorCode.ROLE_FORBIDDEN, f"a token of role {principal.role} may not do this"
            )
        return principal

    return dependency


def check_site(principal: Principal, site_id: str) -> None:
    """Refuse a site outside the token's scope."""
    if not principal.covers_site(site_id):
        raise AppError(ErrorCode.SITE_FORBIDDEN, f"the token is not for site {site_id!r}")


def check_device(principal: Principal, device_id: str) -> None:
    """Refuse a device outside the token's scope."""
    if not principal.covers_device(device_id):
        raise AppError(ErrorCode.DEVICE_FORBIDDEN, f"the token is not for device {device_id!r}")


async def identify(connection: HTTPConnection) -> Principal:
    """Return who opened ``connection``; AppError 401 or 403 if that is not acceptable."""
    token = _token_of_headers(connection)
    if token is None and COOKIE in connection.cookies:
        _check_origin(connection)
        token = connection.cookies[COOKIE]
    return await context_of(connection).authenticator.principal(token)


def _token_of_headers(connection: HTTPConnection) -> str | None:
    scheme, _, credentials = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return credentials.strip()
    if connection.scope["type"] == "websocket":
        offered = connection.headers.get("sec-websocket-protocol", "").split(",")
        for item in map(str.strip, offered):
            if item.startswith("bearer."):
                return item.removeprefix("bearer.")
    return None


def _check_origin(connection: HTTPConnection) -> None:
    """Let a cookie speak only for our own pages (and those of the CORS setting).

    A browser tells the Origin with every WebSocket and every unsafe request of a page.
    """
    origin = connection.headers.get("origin")
    is_socket = connection.scope["type"] == "websocket"
    if origin is None:
        if is_socket:
            raise AppError(ErrorCode.ORIGIN_FORBIDDEN, "a cookie needs an Origin header here")
        return
    if not is_socket and connection.scope["method"] in _SAFE_METHODS:
        return
    own = urlsplit(origin).netloc == connection.headers.get("host")
    if not own and origin not in context_of(connection).cors_origins:
        raise AppError(ErrorCode.ORIGIN_FORBIDDEN, f"pages of {origin!r} may not use the cookie")
