"""README's first fix, typed as it stands, on a real server."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from server_process import ServerProcess

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
CURL_BLOCKS = [b for b in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) if "curl" in b]


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_first_fix_comes_as_the_readme_says(live_server: ServerProcess) -> None:
    answers = []
    for block in CURL_BLOCKS:
        typed = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block],
            env={"PATH": "/usr/bin:/bin", "PHAROS": live_server.url, "TOKEN": live_server.token},
            capture_output=True,
            text=True,
            check=False,
        )
        assert typed.returncode == 0, typed.stdout + typed.stderr
        answers.append(typed.stdout)
    site_and_beacons, posted, asked = answers
    assert '"created":4' in site_and_beacons
    fix = json.loads(posted)["fix"]
    assert fix["floor_id"] == "home-0"
    # In the south-western quarter, as the levels say.
    assert 0 < fix["x"] < 6
    assert 0 < fix["y"] < 4
    later = json.loads(asked)
    assert later["fix"]["x"] == fix["x"]


def test_every_linked_file_is_there() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert links
    root = Path(__file__).parents[2]
    assert not [link for link in links if not (root / link).exists()]
