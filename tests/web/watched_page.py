"""A page of the dashboard under watch: whatever it should not do is kept and told at the end."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from playwright.sync_api import Browser, ConsoleMessage, Page, Request, WebSocket

# What Chromium says of attempts to reach a server that is down; nothing else is let pass.
LOST_SERVER = re.compile(
    r"Failed to load resource: net::ERR_(CONNECTION_REFUSED|CONNECTION_RESET|EMPTY_RESPONSE)"
    r"|WebSocket connection to 'ws://127\.0\.0\.1:\d+/v1/stream' failed: .*"
)
NOT_LOGGED_IN = re.compile(
    r"Failed to load resource: the server responded with a status of 401 \(Unauthorized\)"
)
POLL_MS = 25


class WatchedPage:
    """One browser window on the dashboard.

    Attributes
    ----------
    problems
        Console errors, uncaught exceptions and requests to anywhere but the server.
    """

    def __init__(
        self, browser: Browser, url: str, expected: re.Pattern[str] | None = None, **options: Any
    ) -> None:
        self.url = url
        self.problems: list[str] = []
        self._expected = expected
        self.context = browser.new_context(viewport={"width": 1440, "height": 900}, **options)
        self.page: Page = self.context.new_page()
        self.page.on("console", self._on_console)
        self.page.on("pageerror", lambda error: self.problems.append(f"uncaught: {error}"))
        self.page.on("websocket", self._on_websocket)
        self.context.on("request", self._on_request)

    def open(self, token: str | None) -> None:
        """Go to the page, with a token in the link or without."""
        self.page.goto(self.url + ("/" if token is None else f"/#token={token}"))

    def close(self) -> None:
        """Close the window."""
        self.context.close()

    def evaluate(self, expression: str, argument: object = None) -> Any:
        """Return the value of a JavaScript expression (or function of the argument) in the page."""
        return self.page.evaluate(expression, argument)

    def until(self, expression: str, argument: object = None, *, timeout_s: float = 20.0) -> Any:
        """Wait until the expression is true and return it.

        Playwright's own wait needs `eval` in the page, which the page's policy forbids.
        """
        for _ in range(int(timeout_s * 1000 / POLL_MS)):
            value = self.page.evaluate(expression, argument)
            if value:
                return value
            self.page.wait_for_timeout(POLL_MS)
        message = f"not within {timeout_s} s: {expression} {argument or ''}"
        raise AssertionError(message)

    def person(self, device_id: str) -> dict[str, Any]:
        """Return where somebody is drawn now; waits until they are."""
        found: dict[str, Any] = self.until(
            "id => window.__view.people().find(p => p.device_id === id)", device_id
        )
        return found

    def click_person(self, device_id: str) -> None:
        """Click somebody on the map; they walk on meanwhile, so a miss is tried again."""
        for _ in range(20):
            person = self.person(device_id)
            self.page.mouse.click(person["px"], person["py"])
            if self.evaluate("window.__view.selected_id") == device_id:
                return
        message = f"{device_id} could not be clicked"
        raise AssertionError(message)

    def until_moved(self, device_id: str, metres: float = 1.0) -> None:
        """Wait until somebody is drawn some metres from where they are drawn now."""
        start = self.person(device_id)
        self.until(
            "([id, x, y, metres]) => window.__view.people().some("
            "p => p.device_id === id && Math.hypot(p.x - x, p.y - y) > metres)",
            [device_id, start["x"], start["y"], metres],
        )

    @contextmanager
    def expecting(self, messages: re.Pattern[str]) -> Iterator[None]:
        """Let console errors of this exact kind pass for a while."""
        self._expected = messages
        yield
        self._expected = None

    def _on_console(self, message: ConsoleMessage) -> None:
        expected = self._expected is not None and self._expected.fullmatch(message.text)
        if message.type == "error" and not expected:
            self.problems.append(f"console: {message.text} {message.location}")

    def _on_request(self, request: Request) -> None:
        if urlsplit(request.url).netloc != urlsplit(self.url).netloc:
            self.problems.append(f"external request: {request.url}")

    def _on_websocket(self, socket: WebSocket) -> None:
        if urlsplit(socket.url).netloc != urlsplit(self.url).netloc:
            self.problems.append(f"external socket: {socket.url}")
