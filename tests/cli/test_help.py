"""Asking the command line what it can do: every command says, and none of them is loaded for it."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

from app.cli.main import cli

RADIO_MAP_COMMANDS = (
    "list",
    "build",
    "activate",
    "rollback",
    "compare",
    "export",
    "import",
    "delete",
)
CALIBRATE_COMMANDS = ("beacons", "places", "list", "show", "apply", "discard", "fusion")
COMMANDS = (
    ("serve",),
    ("demo",),
    ("replay",),
    ("migrate",),
    ("plan",),
    ("profiles",),
    *(("calibrate", name) for name in CALIBRATE_COMMANDS),
    ("import", "ms2020"),
    ("import", "csv", "beacons"),
    ("import", "csv", "fingerprints"),
    *(("radio-map", name) for name in RADIO_MAP_COMMANDS),
    *(("growth", name) for name in ("look", "accept", "discard")),
    ("token", "create"),
    ("token", "list"),
    ("token", "revoke"),
)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_tells_its_own_use(command: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, [*command, "--help"], prog_name="pharos", color=False)
    assert result.exit_code == 0, result.output
    assert f"pharos {' '.join(command)} " in result.stdout


def test_help_lists_all_commands_and_loads_no_server() -> None:
    script = (
        "import sys; from app.cli.main import main\n"
        "try: main()\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print(*sys.modules)\n"
    )
    asked = subprocess.run(
        (sys.executable, "-c", script, "--help"), capture_output=True, text=True, check=True
    )
    shown, _, modules = asked.stdout.rstrip().rpartition("\n")
    assert all(command[0] in shown for command in COMMANDS)
    assert not {"fastapi", "numpy", "sqlalchemy", "app.main"} & set(modules.split())


def test_an_unknown_command_is_refused() -> None:
    result = CliRunner().invoke(cli, ["serv"])
    assert result.exit_code == 2
    assert "No such command 'serv'" in result.output
