"""The command line on a fresh database."""

import sys
from pathlib import Path

import pytest
from command_line import Pharos, Result

from app.cli.main import main


@pytest.fixture
def pharos(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], database_url: str
) -> Pharos:
    """Return a function that runs ``pharos`` with arguments on a fresh database."""
    monkeypatch.setenv("PHAROS_DATABASE_URL", database_url)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str | Path) -> Result:
        monkeypatch.setattr(sys, "argv", ["pharos", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as exited:
            code = exited.code if isinstance(exited.code, int) else int(exited.code is not None)
        out, err = capsys.readouterr()
        return Result(code, out, err)

    return run
