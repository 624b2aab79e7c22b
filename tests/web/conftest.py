"""A browser, a server with people walking through its site, and pages under watch."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, sync_playwright
from server_process import ServerProcess
from watched_page import WatchedPage
from yard import Walkers, build_yard

CHROMIUM = Path("/usr/bin/chromium")
QUIET = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


# While it is open Playwright keeps an event loop running in this thread, in which async tests of
# other modules could not run: it must not outlive its module.
@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Debian's Chromium with a fresh profile; its absence is a failure only where CI is set."""
    if not CHROMIUM.exists():
        reason = f"no Chromium in {CHROMIUM} (Debian package chromium)"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def yard_server(
    _sqlite_template: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServerProcess]:
    """Return a server whose one site is the yard, with its walkers walking."""
    folder = tmp_path_factory.mktemp("yard")
    path = shutil.copy(_sqlite_template, folder / "pharos.db")
    server = ServerProcess(f"sqlite:///{path}", folder / "server.log")
    server.start()
    try:
        with server.client() as client:
            build_yard(client)
        with Walkers(server.url, server.token):
            yield server
    finally:
        server.kill()


OpenPage = Callable[..., WatchedPage]


@pytest.fixture
def open_page(browser: Browser, yard_server: ServerProcess) -> Iterator[OpenPage]:
    """Return a function that opens the dashboard; what went wrong in any page fails the test."""
    opened: list[WatchedPage] = []

    def open_one(
        *, by_link: bool = True, expected: re.Pattern[str] | None = None, **options: Any
    ) -> WatchedPage:
        page = WatchedPage(browser, yard_server.url, expected, **options)
        opened.append(page)
        page.open(yard_server.token if by_link else None)
        return page

    yield open_one
    for page in opened:
        page.close()
    assert [problem for page in opened for problem in page.problems] == []
