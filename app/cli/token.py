"""``pharos token``: make, list and revoke access tokens of the local database."""

import asyncio
import re
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from app.cli.errors import CommandError
from app.cli.local import CLOCK, DatabaseOption, local_database
from app.services.access import Role
from app.services.issue_tokens import TokenGrant, issue_token
from app.services.issue_tokens import revoke as revoke_token
from app.storage.tokens import StoredToken, list_tokens

tokens = typer.Typer(no_args_is_help=True, help="Make, list and revoke access tokens.")

_UNIT_S = {"m": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
_MANY = 10_000


@tokens.command("create")
def create(  # noqa: PLR0913 - one parameter per option
    role: Annotated[Role, typer.Option(help="What the token may do.")],
    name: Annotated[str, typer.Option(help="What it is for, as the list shows it.")] = "",
    site: Annotated[str | None, typer.Option(help="The one site it is for.")] = None,
    device: Annotated[str | None, typer.Option(help="The one device it is for.")] = None,
    prefix: Annotated[
        str | None, typer.Option(help="Devices whose id begins like this may use it.")
    ] = None,
    expires: Annotated[
        str | None, typer.Option(metavar="30d|12h|90m|4w", help="How long it is good for.")
    ] = None,
    database: DatabaseOption = None,
) -> None:
    """Make a token and print it, once: only its hash is stored."""
    _check_scope(role, device, prefix)
    created_s = CLOCK.now_s()
    expires_s = None if expires is None else created_s + _duration_s(expires)
    grant = TokenGrant(name, role, site, device, prefix, expires_s)
    with local_database(database) as store:
        secret, stored = asyncio.run(issue_token(store, grant, created_s))
    Console(stderr=True).print(f"Token {stored.token_id}, role {role.value}; shown only now:")
    typer.echo(secret)


@tokens.command("list")
def show(database: DatabaseOption = None) -> None:
    """List the tokens; the secrets are not stored and cannot be shown."""
    with local_database(database) as store:
        found = store.read_now(lambda c: list_tokens(c, site_id=None, after=None, limit=_MANY))
    table = Table("id", "role", "name", "site", "device", "state")
    for token in found:
        device = token.device_id or (f"{token.device_prefix}*" if token.device_prefix else "")
        table.add_row(
            token.token_id, token.role, token.name, token.site_id or "all", device, _state(token)
        )
    Console().print(table)


@tokens.command("revoke")
def revoke(
    token_id: Annotated[str, typer.Argument(help="Id of the token, as the list shows it.")],
    database: DatabaseOption = None,
) -> None:
    """Revoke a token for good; a running server notices within seconds."""
    with local_database(database) as store:
        asyncio.run(revoke_token(store, token_id, CLOCK.now_s()))
    Console().print(f"Token {token_id} is revoked.")


def _check_scope(role: Role, device: str | None, prefix: str | None) -> None:
    named = (device is not None) + (prefix is not None)
    if role is Role.DEVICE and named != 1:
        msg = "a token of role device needs --device or --prefix"
        raise CommandError(msg, 2)
    if role is not Role.DEVICE and named:
        msg = "--device and --prefix are for the role device"
        raise CommandError(msg, 2)


def _duration_s(text: str) -> float:
    match = re.fullmatch(r"(\d{1,5})([mhdw])", text)
    if match is None or match[1].strip("0") == "":
        msg = f"--expires {text!r} is not like 90m, 12h, 30d or 4w"
        raise CommandError(msg, 2)
    return int(match[1]) * _UNIT_S[match[2]]


def _state(token: StoredToken) -> str:
    if token.revoked_s is not None:
        return "revoked"
    if token.expires_s is not None and token.expires_s <= CLOCK.now_s():
        return "expired"
    return "valid"
