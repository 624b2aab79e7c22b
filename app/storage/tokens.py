"""Access tokens as stored: only their hash, with role, scope and times."""

from dataclasses import dataclass

from sqlalchemy import Connection, RowMapping, delete, insert, select, update

from app.storage.rows import unique
from app.storage.tables import TOKENS


@dataclass(frozen=True, slots=True)
class StoredToken:
    """One token; the secret itself is nowhere, only its SHA-256.

    Attributes
    ----------
    site_id
        The one site it is for; None: every site.
    device_id, device_prefix
        For the role ``device``: the one device, or the beginning of the ids it may enrol.
    """

    token_id: str
    name: str
    token_hash: bytes
    role: str
    created_s: float
    site_id: str | None = None
    device_id: str | None = None
    device_prefix: str | None = None
    expires_s: float | None = None
    revoked_s: float | None = None


def create_token(connection: Connection, token: StoredToken) -> StoredToken:
    """Store a new token."""
    with unique(f"token {token.token_id!r}"):
        connection.execute(
            insert(TOKENS).values(
                id=token.token_id,
                token_hash=token.token_hash,
                label=token.name,
                role=token.role,
                site_id=token.site_id,
                device_id=token.device_id,
                device_prefix=token.device_prefix,
                created_s=token.created_s,
                expires_s=token.expires_s,
                revoked_s=token.revoked_s,
            )
        )
    return token


def find_token(connection: Connection, token_hash: bytes) -> StoredToken | None:
    """Return the token with this hash, unless it was revoked; expired ones are returned."""
    query = select(TOKENS).where(TOKENS.c.token_hash == token_hash, TOKENS.c.revoked_s.is_(None))
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _token(row)


def get_token(connection: Connection, token_id: str) -> StoredToken | None:
    """Return a token by its id, revoked ones too."""
    query = select(TOKENS).where(TOKENS.c.id == token_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _token(row)


def any_token(connection: Connection) -> bool:
    """Tell whether there is any token at all: none means a first start."""
    return connection.execute(select(TOKENS.c.id).limit(1)).first() is not None


def list_tokens(
    connection: Connection, *, site_id: str | None, after: str | None, limit: int
) -> list[StoredToken]:
    """Return up to ``limit + 1`` tokens by id, of one site or all."""
    query = select(TOKENS).order_by(TOKENS.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(TOKENS.c.site_id == site_id)
    if after is not None:
        query = query.where(TOKENS.c.id > after)
    return [_token(row) for row in connection.execute(query).mappings()]


def revoke_token(connection: Connection, token_id: str, revoked_s: float) -> bool:
    """Revoke a token for good; False if there is none. A second time changes nothing."""
    changed = connection.execute(
        update(TOKENS)
        .where(TOKENS.c.id == token_id, TOKENS.c.revoked_s.is_(None))
        .values(revoked_s=revoked_s)
    )
    return changed.rowcount == 1 or get_token(connection, token_id) is not None


def delete_tokens_of_device(connection: Connection, device_id: str) -> None:
    """Remove the tokens made for one device."""
    connection.execute(delete(TOKENS).where(TOKENS.c.device_id == device_id))


def _token(row: RowMapping) -> StoredToken:
    fields = dict(row)
    return StoredToken(token_id=fields.pop("id"), name=fields.pop("label"), **fields)
