"""The first start with an empty database: one admin token, shown once."""

from sqlalchemy import Connection

from app.services.access import Role
from app.services.issue_tokens import TokenGrant, token_of
from app.services.tokens import new_token
from app.storage.database import Database
from app.storage.tokens import any_token, create_token


async def make_first_token(database: Database, now_s: float) -> str | None:
    """Return a new admin token if there is no token at all yet, else None."""
    secret = new_token()

    def statement(connection: Connection) -> bool:
        if any_token(connection):
            return False
        token = token_of(TokenGrant("first start", Role.ADMIN), secret, now_s)
        create_token(connection, token)
        return True

    return secret if await database.write(statement) else None
