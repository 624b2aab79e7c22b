"""Making and revoking tokens."""

from dataclasses import dataclass

from sqlalchemy import Connection

from app.services.access import Role
from app.services.errors import found
from app.services.tokens import hash_token, new_token
from app.services.writing import write
from app.storage import sites, tokens
from app.storage.database import Database
from app.storage.tokens import StoredToken


@dataclass(frozen=True, slots=True)
class TokenGrant:
    """What a new token allows."""

    name: str
    role: Role
    site_id: str | None = None
    device_id: str | None = None
    device_prefix: str | None = None
    expires_s: float | None = None


def token_of(grant: TokenGrant, secret: str, created_s: float) -> StoredToken:
    """Return what is stored of a token."""
    token_hash = hash_token(secret)
    return StoredToken(
        token_id=f"tok-{token_hash.hex()[:12]}",
        name=grant.name,
        token_hash=token_hash,
        role=grant.role.value,
        created_s=created_s,
        site_id=grant.site_id,
        device_id=grant.device_id,
        device_prefix=grant.device_prefix,
        expires_s=grant.expires_s,
    )


async def issue_token(
    database: Database, grant: TokenGrant, created_s: float
) -> tuple[str, StoredToken]:
    """Make a token; return its secret, which is stored nowhere, and what is stored."""
    secret = new_token()

    def statement(connection: Connection) -> StoredToken:
        if grant.site_id is not None:
            found(sites.get_site(connection, grant.site_id), "site", grant.site_id)
        return tokens.create_token(connection, token_of(grant, secret, created_s))

    return secret, await write(database, statement)


async def revoke(database: Database, token_id: str, now_s: float) -> None:
    """Revoke a token for good."""
    known = await write(database, lambda c: tokens.revoke_token(c, token_id, now_s))
    found(known or None, "token", token_id)
