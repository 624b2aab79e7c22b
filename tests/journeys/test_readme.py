"""README's first fix, typed as it stands, on a real server."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from server_process import ServerProcess
from typed_blocks import shell_blocks, typed

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
CURL_BLOCKS = shell_blocks("README.md", "curl")


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_the_first_fix_comes_as_the_readme_says(live_server: ServerProcess) -> None:
    answers = [typed(live_server, block) for block in CURL_BLOCKS]
    site_and_beacons, posted, asked = answers
    assert '"created":4' in site_and_beacons
    fix = json.loads(posted)["fix"]
    assert fix["floor_id"] == "home-0"
    # In the south-western quarter, as the levels say.
    assert 0 < fix["x"] < 6
    assert 0 < fix["y"] < 4
    later = json.loads(asked)
    assert later["fix"]["x"] == fix["x"]
    _try_the_page_on_profiles(live_server, later["fix"])


def _try_the_page_on_profiles(server: ServerProcess, fix: dict[str, Any]) -> None:
    """Type what docs/profiles.md goes on with, in the same home."""
    listed, shown, switched, replayed = [
        typed(server, block)
        for word in ("pharos profiles", "curl")
        for block in shell_blocks("docs/profiles.md", word)
    ]
    assert {"best", "max_age_s"} <= set(re.findall(r"\w+", listed))
    assert json.loads(shown)["name"] == "best"
    assert '"default_profile":"best"' in switched
    assert '"profile":"best"' in switched
    (point,) = json.loads(replayed)["items"]
    # Smoothing moves a single point by nothing.
    assert (point["x"], point["y"]) == pytest.approx((fix["x"], fix["y"]), abs=1e-6)


def test_every_linked_file_is_there() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert links
    root = Path(__file__).parents[2]
    assert not [link for link in links if not (root / link).exists()]
