"""``pharos profiles``: the profiles of this build, with the parameters that each reads."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Table

from app.cli.errors import CommandError
from app.services.profiles import (
    ParameterGroup,
    ParameterView,
    ProfileView,
    list_profiles,
    unknown_profile,
)


def profiles(
    name: Annotated[
        str | None, typer.Argument(metavar="[PROFILE]", help="Only this one, with its parameters.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON, with the parameters.")] = False,
) -> None:
    """Show the profiles that sites, devices and sessions may name, and their parameters."""
    shown = [profile for profile in list_profiles() if name in {None, profile.name}]
    if not shown:
        raise CommandError(unknown_profile(str(name)), 2)
    if json:
        content = asdict(shown[0]) if name else [asdict(profile) for profile in shown]
        typer.echo(msgspec.json.format(msgspec.json.encode(content)))
        return
    Console().print(_summary(shown) if name is None else _parameters(shown[0]))


def _summary(shown: Iterable[ProfileView]) -> Table:
    table = Table("profile", "what it is", "source")
    for profile in shown:
        table.add_row(profile.name, profile.title, profile.source)
    return table


def _parameters(profile: ProfileView) -> Table:
    table = Table(title=f"{profile.name}: {profile.title}", caption=profile.source)
    table.add_column("parameter", no_wrap=True)
    table.add_column("value", justify="right")
    table.add_column("unit", no_wrap=True)
    table.add_column("meaning")
    for path, parameter in _rows("", profile.parameters, profile.groups):
        value = "" if parameter.value is None else str(parameter.value)
        table.add_row(path + parameter.name, value, parameter.unit, parameter.description)
    return table


def _rows(
    path: str, parameters: Iterable[ParameterView], groups: Iterable[ParameterGroup]
) -> Iterator[tuple[str, ParameterView]]:
    for parameter in parameters:
        yield path, parameter
    for group in groups:
        yield from _rows(f"{path}{group.name}.", group.parameters, group.groups)
