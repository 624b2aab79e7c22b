"""A phone's side of the HTTP API: reads the site, posts batches, and tries again when it may."""

import asyncio
import gzip
import math
import secrets
from dataclasses import dataclass
from typing import Any, Self

import httpx

from app.cli.errors import CommandError

# What a phone may try again: too early, too busy, or a proxy whose server is away.
_RETRIED = frozenset({408, 429, 502, 503, 504})
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 8.0
_GIVE_UP_AFTER_S = 120.0
_TIMEOUT_S = 30.0

_random = secrets.SystemRandom()


@dataclass(frozen=True, slots=True)
class SiteFloor:
    """A floor as the server tells it: its name and where its plan lies in the site frame."""

    floor_id: str
    name: str
    x0_m: float
    y0_m: float


class PhoneClient:
    """Keeps connections to one server open; use as an async context manager."""

    def __init__(self, url: str, token: str, connections: int) -> None:
        self._url = url.rstrip("/")
        try:
            self._http = httpx.AsyncClient(
                base_url=self._url,
                headers={"Authorization": f"Bearer {token}"},
                timeout=_TIMEOUT_S,
                limits=httpx.Limits(max_connections=connections),
            )
        except (httpx.InvalidURL, ValueError) as error:
            msg = f"--server {url!r} or the token cannot be used: {error}"
            raise CommandError(msg, 2) from error

    async def __aenter__(self) -> Self:
        """Open nothing yet: connections are made as they are needed."""
        return self

    async def __aexit__(self, *_exception: object) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def only_site(self) -> str:
        """Return the id of the server's one site."""
        sites = await self._get_items("/v1/sites", {})
        if len(sites) != 1:
            ids = ", ".join(str(site["site_id"]) for site in sites) or "none"
            msg = f"name the site with --site; the server has: {ids}"
            raise CommandError(msg, 2)
        return str(sites[0]["site_id"])

    async def floors(self, site_id: str) -> list[SiteFloor]:
        """Return the floors of a site."""
        floors = await self._get_items("/v1/floors", {"site_id": site_id})
        return [SiteFloor(f["floor_id"], f["name"], f["x0"], f["y0"]) for f in floors]

    async def post_batch(self, body: bytes) -> dict[str, Any]:
        """Post an ingest body until it is acknowledged; return the reply.

        The bytes stay the same from try to try: the server knows a batch that it has already.
        """
        headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
        packed = gzip.compress(body, compresslevel=1, mtime=0)
        waited_s, wait_s = 0.0, _FIRST_WAIT_S
        while True:
            try:
                reply = await self._http.post("/v1/ingest", content=packed, headers=headers)
            except httpx.TransportError as error:
                reason, asked_s = f"{self._url} is not reachable: {_words(error)}", 0.0
            else:
                if reply.status_code not in _RETRIED:
                    return self._json_of(reply)
                reason, asked_s = f"the server answers {_problem(reply)}", _retry_after_s(reply)
            if waited_s > _GIVE_UP_AFTER_S:
                raise CommandError(reason)
            # Full jitter: phones that failed together do not come back together.
            pause_s = asked_s + _random.uniform(0.0, wait_s)
            await asyncio.sleep(pause_s)
            waited_s += pause_s
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)

    async def _get_items(self, path: str, query: dict[str, str]) -> list[dict[str, Any]]:
        items: list[dict[str, Any]] = []
        cursor: str | None = None
        while True:
            following = {} if cursor is None else {"cursor": cursor}
            try:
                reply = await self._http.get(path, params={**query, **following})
            except httpx.TransportError as error:
                msg = f"{self._url} is not reachable: {_words(error)}"
                raise CommandError(msg) from error
            page = self._json_of(reply)
            items += page["items"]
            cursor = page["next_cursor"]
            if cursor is None:
                return items

    def _json_of(self, reply: httpx.Response) -> dict[str, Any]:
        if reply.is_success:
            try:
                document: dict[str, Any] = reply.json()
            except ValueError as error:
                msg = f"{self._url} does not answer like a Pharos server"
                raise CommandError(msg) from error
            return document
        msg = f"{self._url} refuses: {_problem(reply)}"
        raise CommandError(msg)


def _words(error: httpx.TransportError) -> str:
    return str(error) or type(error).__name__


def _problem(reply: httpx.Response) -> str:
    try:
        document = reply.json()
        return f"{reply.status_code} {document['code']}: {document['detail']}"
    except (ValueError, KeyError, TypeError):
        return f"{reply.status_code} {reply.reason_phrase}"


def _retry_after_s(reply: httpx.Response) -> float:
    try:
        asked_s = float(reply.headers.get("Retry-After", "0"))
    except ValueError:
        return 0.0
    return min(asked_s, _LONGEST_WAIT_S) if math.isfinite(asked_s) and asked_s > 0 else 0.0
