"""The shell blocks of a page, typed as they stand against a server."""

import os
import re
import subprocess
import sys
from pathlib import Path

from server_process import ServerProcess

ROOT = Path(__file__).parents[2]
PHAROS = f"{sys.executable} -c 'from app.cli.main import main; main()'"


def shell_blocks(page: str, word: str) -> list[str]:
    """Return the shell blocks of a page of ours that have a word in them."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return [b for b in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) if word in b]


def typed(server: ServerProcess, block: str) -> str:
    """Return what a block prints; it must succeed."""
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.replace(".venv/bin/pharos", PHAROS)],
        env={
            "PATH": "/usr/bin:/bin",
            "PHAROS": server.url,
            "TOKEN": server.token,
            "PYTHONPATH": os.environ.get("PYTHONPATH", ""),
        },
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
