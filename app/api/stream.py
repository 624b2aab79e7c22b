"""``WS /v1/stream``: what sessions say now, to whoever subscribes.

Frames in: subscribe, unsubscribe, ping. Frames out: subscribed (with a snapshot), event, pong,
error. A slow client gets the newest fix of each device, never a queue of old ones.
"""

import asyncio
from collections.abc import Iterator
from contextlib import suppress
from enum import StrEnum
from typing import Annotated, Any, TypeAlias

import msgspec
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from msgspec import Meta, Struct, field
from starlette.websockets import WebSocketState

from app.api.auth import READERS, Principal, Role, check_device, check_site, identify
from app.api.context import ApiContext, context_of
from app.api.fix import report_json
from app.api.ingest_decode import decode_body
from app.api.jobs import job_view
from app.api.socket import GOING_AWAY, TOO_SLOW, admit, close_socket, next_text
from app.core.types import Output
from app.services.errors import AppError, ErrorCode
from app.sessions.hub import (
    Frames,
    StreamClosedError,
    StreamFilter,
    StreamGapError,
    Subscription,
    Topic,
)
from app.storage.jobs import StoredJob

router = APIRouter()

MAX_FRAME_BYTES = 64 * 1024
MAX_SUBSCRIPTIONS = 16
# What comes in between is joined: a thousand phones a second make ten frames.
DEFAULT_HZ = 10.0

Id: TypeAlias = Annotated[str, Meta(min_length=1, max_length=64)]


class Wanted(Struct):
    """What a subscriber wants to see; everything that is left out is not limited."""

    site_id: Id | None = None
    floor_id: Id | None = None
    device: Annotated[list[Id], Meta(max_length=1000)] | None = None
    max_hz: Annotated[float, Meta(gt=0, le=100)] | None = None


class Subscribe(Struct, tag_field="op", tag="subscribe"):
    """Start to listen to a topic, under a name of the client's choice."""

    id: Id
    topic: Id
    filter: Wanted = field(default_factory=Wanted)


class Unsubscribe(Struct, tag_field="op", tag="unsubscribe"):
    """Stop listening."""

    id: Id


class Ping(Struct, tag_field="op", tag="ping"):
    """Ask for a pong."""


Frame: TypeAlias = Subscribe | Unsubscribe | Ping
_FRAMES: msgspec.json.Decoder[Frame] = msgspec.json.Decoder(Frame)


class _Named(Struct):
    id: str | None = None


class StreamCode(StrEnum):
    """Codes of error frames beside those of refused requests."""

    UNKNOWN_TOPIC = "unknown_topic"
    UNKNOWN_SUBSCRIPTION = "unknown_subscription"
    TOO_MANY_SUBSCRIPTIONS = "too_many_subscriptions"


class FrameError(Exception):
    """A well-formed frame that cannot be followed."""

    def __init__(self, code: StreamCode, detail: str) -> None:
        super().__init__(detail)
        self.code = code


@router.websocket("/v1/stream")
async def stream(websocket: WebSocket) -> None:
    """Serve one client until it, its token or the server goes."""
    principal = await admit(websocket, *READERS, Role.DEVICE)
    if principal is None:
        return
    listener = _Listener(websocket, context_of(websocket), principal)
    try:
        while (text := await next_text(websocket, MAX_FRAME_BYTES)) is not None:
            await listener.take(text)
    finally:
        await listener.close()


class _Listener:
    """One client's subscriptions; each has a task that drains its slots."""

    def __init__(self, websocket: WebSocket, context: ApiContext, principal: Principal) -> None:
        self._websocket = websocket
        self._context = context
        self._principal = principal
        self._subscriptions: dict[str, Subscription] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def take(self, text: str) -> None:
        """Do what a frame asks; answer an error frame if it cannot be done."""
        body = text.encode()
        try:
            match decode_body(body, _FRAMES):
                case Subscribe() as wish:
                    await self._subscribe(wish)
                case Unsubscribe(id=name):
                    await self._unsubscribe(name)
                case Ping():
                    await self._send({"op": "pong"})
        except (AppError, FrameError) as refused:
            error = {"op": "error", "id": _name_in(body), "code": refused.code}
            await self._send({**error, "detail": str(refused)})

    async def close(self) -> None:
        """Stop all subscriptions and wait for their tasks."""
        for subscription in self._subscriptions.values():
            subscription.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _subscribe(self, wish: Subscribe) -> None:
        topic = _topic(wish.topic)
        if topic is Topic.JOBS and self._principal.role is Role.DEVICE:
            raise AppError(ErrorCode.ROLE_FORBIDDEN, "a phone has no part in jobs")
        wanted = _scoped(wish.filter, self._principal)
        if wish.id in self._subscriptions:
            await self._unsubscribe(wish.id)
        if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
            msg = f"a socket has at most {MAX_SUBSCRIPTIONS} subscriptions"
            raise FrameError(StreamCode.TOO_MANY_SUBSCRIPTIONS, msg)
        subscription = self._context.hub.subscribe([topic], wanted)
        self._subscriptions[wish.id] = subscription
        snapshot = self._snapshot(topic, wanted)
        await self._send({"op": "subscribed", "id": wish.id, "snapshot": snapshot})
        pause_s = 1.0 / (wish.filter.max_hz or DEFAULT_HZ)
        task = asyncio.create_task(self._drain(wish.id, subscription, pause_s))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _unsubscribe(self, name: str) -> None:
        subscription = self._subscriptions.pop(name, None)
        if subscription is None:
            msg = f"there is no subscription {name!r}"
            raise FrameError(StreamCode.UNKNOWN_SUBSCRIPTION, msg)
        subscription.close()

    def _snapshot(self, topic: Topic, wanted: StreamFilter) -> list[Any]:
        if topic is Topic.JOBS:
            live = self._context.jobs.live
            return [self._content(job) for job in live if wanted.covers(job.site_id, None)]
        if topic is not Topic.FIXES:
            return []
        site_ids = [wanted.site_id] if wanted.site_id else self._context.directory.site_ids()
        return [
            self._report(device_id, site_id, output)
            for site_id in site_ids
            for device_id, output in self._context.registry.latest_at(site_id).items()
            if wanted.covers(site_id, device_id) and wanted.shows(output)
        ]

    async def _drain(self, name: str, subscription: Subscription, pause_s: float) -> None:
        try:
            while True:
                frames = await subscription.next_frames()
                # Asked again each time: a token may be revoked while its socket is open.
                await identify(self._websocket)
                for frame in self._event_frames(name, frames):
                    await self._send(frame)
                await asyncio.sleep(pause_s)
        except StreamGapError as gap:
            await self._end(TOO_SLOW, str(gap))
        except StreamClosedError:
            if self._subscriptions.get(name) is subscription:
                await self._end(GOING_AWAY, "the server goes down")
        except AppError as refused:
            await close_socket(self._websocket, refused)
        except WebSocketDisconnect:
            # The reading side notices too and ends everything.
            return

    def _event_frames(self, name: str, frames: Frames) -> Iterator[dict[str, Any]]:
        for event in frames.events:
            eid = str(event.event_id)
            yield {"op": "event", "id": name, "eid": eid, "data": [self._content(event.content)]}
        if frames.outputs:
            reports = [self._report(o.device_id, o.site_id, o.output) for o in frames.outputs]
            yield {"op": "event", "id": name, "data": reports}

    def _content(self, content: object) -> object:
        """Return what an event speaks of as a client gets it from the routes, too."""
        if isinstance(content, StoredJob):
            return job_view(content, self._principal).model_dump()
        return content

    def _report(self, device_id: str, site_id: str, output: Output) -> dict[str, Any]:
        georeference = self._context.directory.georeference(site_id)
        return report_json(device_id, site_id, output, georeference)

    async def _send(self, frame: dict[str, Any]) -> None:
        await self._websocket.send_text(msgspec.json.encode(frame).decode())

    async def _end(self, code: int, reason: str) -> None:
        if self._websocket.application_state is WebSocketState.CONNECTED:
            await self._websocket.close(code, reason)


def _topic(name: str) -> Topic:
    try:
        return Topic(name)
    except ValueError as error:
        msg = f"there is no topic {name!r}; there are {', '.join(Topic)}"
        raise FrameError(StreamCode.UNKNOWN_TOPIC, msg) from error


def _scoped(wanted: Wanted, principal: Principal) -> StreamFilter:
    """Return the filter of what is wanted within what the token reaches."""
    site_id = wanted.site_id or principal.site_id
    if site_id is not None:
        check_site(principal, site_id)
    device_ids = wanted.device
    if principal.role is Role.DEVICE:
        device_ids = device_ids or [principal.device_id or ""]
        for device_id in device_ids:
            check_device(principal, device_id)
    return StreamFilter(
        site_id, None if device_ids is None else frozenset(device_ids), wanted.floor_id
    )


def _name_in(body: bytes) -> str | None:
    with suppress(msgspec.DecodeError, RecursionError):
        return msgspec.json.decode(body, type=_Named).id
    return None
