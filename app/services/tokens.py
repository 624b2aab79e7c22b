"""Bearer tokens: making them, and finding out who bears one.

A token is 256 random bits, so its plain SHA-256 is stored: nobody can try 2^256 values, and a slow
password hash, which makes guessing *weak* secrets costly, would only make every request slow.
"""

import hashlib
import secrets
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from app.services.access import Principal, Role
from app.services.errors import AppError, ErrorCode, unavailable
from app.sessions.ports import Clock
from app.storage.database import DatabaseUnavailableError
from app.storage.tokens import StoredToken

TokenLookup: TypeAlias = Callable[[bytes], Awaitable[StoredToken | None]]

# Wrong tokens are remembered too, so the memory needs a bound; when it is reached all is forgotten.
_CACHE_LIMIT = 10_000


def new_token() -> str:
    """Return a fresh secret; it is shown once and never stored."""
    return f"pharos_{secrets.token_urlsafe(32)}"


def hash_token(token: str) -> bytes:
    """Return what is stored of a token."""
    return hashlib.sha256(token.encode()).digest()


class Authenticator:
    """Turns tokens into principals; remembers look-ups for a short time.

    A revocation in this process calls `forget`; another process notices it after ``cache_s``.
    """

    def __init__(self, lookup: TokenLookup, clock: Clock, cache_s: float) -> None:
        self._lookup = lookup
        self._clock = clock
        self._cache_s = cache_s
        self._known: dict[bytes, tuple[float, StoredToken | None]] = {}

    async def principal(self, token: str | None) -> Principal:
        """Return who bears ``token``; AppError 401 if nobody may."""
        if not token:
            raise AppError(ErrorCode.TOKEN_MISSING, "a bearer token is needed")
        stored = await self._stored(hash_token(token))
        if stored is None:
            raise AppError(ErrorCode.TOKEN_INVALID, "the token is unknown or was revoked")
        if stored.expires_s is not None and stored.expires_s <= self._clock.now_s():
            raise AppError(ErrorCode.TOKEN_EXPIRED, "the token has expired")
        return Principal(
            stored.token_id,
            Role(stored.role),
            stored.site_id,
            stored.device_id,
            stored.device_prefix,
        )

    def forget(self) -> None:
        """Drop everything remembered: call it after creating, changing or revoking a token."""
        self._known.clear()

    async def _stored(self, token_hash: bytes) -> StoredToken | None:
        now_s = self._clock.now_s()
        if token_hash in self._known:
            until_s, stored = self._known[token_hash]
            if now_s < until_s:
                return stored
        try:
            stored = await self._lookup(token_hash)
        except DatabaseUnavailableError as error:
            raise unavailable() from error
        if len(self._known) >= _CACHE_LIMIT:
            self._known.clear()
        self._known[token_hash] = (now_s + self._cache_s, stored)
        return stored
