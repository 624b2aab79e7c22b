"""``pharos demo`` in a process of its own: link, people on the plan, and a clean end."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from app.cli.demo import demo
from app.cli.errors import CommandError

COMMAND = (sys.executable, "-c", "from app.cli.main import main; main()", "demo")
PHONES = 4
PEOPLE = {f"picker-00{i}": f"Picker 00{i}" for i in range(1, 1 + PHONES)}
FIRST_FIXES_LIMIT_S = 60.0
# Twice what is asked for, on a machine that runs other tests beside it.
STOP_LIMIT_S = 4.0


@contextmanager
def _demo(*options: str) -> Iterator["subprocess.Popen[str]"]:
    process = subprocess.Popen(
        (*COMMAND, "--port", "0", "--phones", str(PHONES), *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def _told(process: "subprocess.Popen[str]", pattern: str) -> re.Match[str]:
    """Return the match in the next line that has one; what it said instead is the failure."""
    said = []
    assert process.stdout is not None
    for line in process.stdout:
        said.append(line)
        if match := re.search(pattern, line):
            return match
    raise AssertionError("".join(said))


def test_the_link_opens_on_people_who_move_and_ctrl_c_ends_it() -> None:
    with _demo() as process:
        folder = Path(_told(process, r"Database +(\S+)")[1])
        link = _told(process, r"(http://127\.0\.0\.1:\d+)/#token=(\S+)")
        with httpx.Client(base_url=link[1], timeout=10.0, trust_env=False) as page:
            assert page.get("/").is_success
            page.post("/v1/login", json={"token": link[2]}).raise_for_status()
            fixes = _fixes_of_all(page)
            devices = page.get("/v1/devices").raise_for_status().json()["items"]
            floors = page.get("/v1/floors").raise_for_status().json()["items"]
            plan = page.get(f"/v1/floors/{floors[0]['floor_id']}/plan").raise_for_status()
        assert {fix["floor_id"] for fix in fixes} <= {floor["floor_id"] for floor in floors}
        assert {d["device_id"]: d["person"] for d in devices} == PEOPLE
        assert plan.headers["content-type"] == "image/png"
        assert (folder / "pharos.db").exists()
        begin_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=30.0)
        assert time.monotonic() - begin_s < STOP_LIMIT_S
        assert process.returncode == 0, said
        assert "Stopped." in said
        assert "Traceback" not in said
        assert not folder.exists()


def _fixes_of_all(page: httpx.Client) -> list[dict[str, object]]:
    deadline_s = time.monotonic() + FIRST_FIXES_LIMIT_S
    while time.monotonic() < deadline_s:
        fixes = page.get("/v1/fixes").raise_for_status().json()["items"]
        if len(fixes) == PHONES:
            return fixes
        time.sleep(0.1)
    msg = f"not all of {PHONES} phones have a fix: {fixes}"
    raise AssertionError(msg)


def test_it_ends_by_itself_and_keeps_the_folder_it_was_given(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    with _demo("--seconds", "3", "--speed", "10", "--folder", str(folder)) as process:
        fixes = int(_told(process, r"Done: \d+ batches, (\d+) fixes")[1])
        assert process.wait(timeout=30.0) == 0
    # Ten event seconds a second; on a slow machine at least some.
    assert fixes > 4 * PHONES
    assert (folder / "pharos.db").exists()
    with pytest.raises(CommandError, match="has a database already"):
        demo(folder=folder)
