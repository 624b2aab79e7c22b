"""Commands that are imported when they are called: asking for help must not load a server."""

import importlib
from collections.abc import Mapping
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command


def lazy_group(commands: Mapping[str, tuple[str, str]]) -> type[TyperGroup]:
    """Return a group of commands, each given by ``module:name`` and a line of help."""

    class LazyGroup(TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401
            return list(commands)

        def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:  # noqa: ANN401
            known = commands.get(cmd_name)
            return TyperCommand(cmd_name, help=known[1]) if known else None

        def resolve_command(
            self,
            ctx: Any,  # noqa: ANN401 - its type is typer's own affair
            args: list[str],
        ) -> tuple[str | None, Any, list[str]]:
            name, command, rest = super().resolve_command(ctx, args)
            return name, _loaded(commands[name][0]) if name else command, rest

    return LazyGroup


def _loaded(path: str) -> Any:  # noqa: ANN401 - a command or a group of typer's
    module, _, name = path.partition(":")
    found = getattr(importlib.import_module(module), name)
    if isinstance(found, typer.Typer):
        return get_command(found)
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    alone.command()(found)
    return get_command(alone)
