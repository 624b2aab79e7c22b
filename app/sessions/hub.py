"""The hub: what sessions say now, to everyone who listens; who stalls delays nobody else."""

import asyncio
import itertools
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Self

from app.core.types import Output, TrackPoint


class Topic(StrEnum):
    """What can be listened to."""

    FIXES = "fixes"
    DEVICES = "devices"
    JOBS = "jobs"


@dataclass(frozen=True, slots=True)
class LiveOutput:
    """A device's latest position or its absence."""

    site_id: str
    device_id: str
    output: Output


@dataclass(frozen=True, slots=True)
class LiveEvent:
    """Something that happened once; ``event_id`` grows."""

    event_id: int
    topic: Topic
    site_id: str | None
    device_id: str | None
    content: object


@dataclass(frozen=True, slots=True)
class Frames:
    """All that a subscriber has not seen yet: events in order, then one output per device."""

    events: tuple[LiveEvent, ...]
    outputs: tuple[LiveOutput, ...]


@dataclass(frozen=True, slots=True)
class StreamFilter:
    """What a subscriber wants to see; None is everything.

    With a floor, a device that leaves it is shown once more, so that a map can take it away.
    """

    site_id: str | None = None
    device_ids: frozenset[str] | None = None
    floor_id: str | None = None

    def covers(self, site_id: str | None, device_id: str | None) -> bool:
        """Tell whether something of this site and device is wanted; None concerns all of them."""
        if None not in (self.site_id, site_id) and site_id != self.site_id:
            return False
        return self.device_ids is None or device_id is None or device_id in self.device_ids

    def shows(self, output: Output) -> bool:
        """Tell whether the output is on the wanted floor."""
        if self.floor_id is None:
            return True
        return isinstance(output, TrackPoint) and output.floor_id == self.floor_id


class StreamGapError(Exception):
    """The subscriber was too slow for its events and must come back; ``lost`` of them are gone."""

    def __init__(self, lost: int) -> None:
        super().__init__(f"{lost} events lost")
        self.lost = lost


class StreamClosedError(Exception):
    """The subscription or its hub was closed."""


class Subscription:
    """One listener's slots; an async context manager that unsubscribes."""

    def __init__(
        self, hub: "Hub", topics: frozenset[Topic], wanted: StreamFilter, max_events: int
    ) -> None:
        self.topics = topics
        self._hub = hub
        self._wanted = wanted
        self._max_events = max_events
        self._outputs: dict[str, LiveOutput] = {}
        self._events: deque[LiveEvent] = deque()
        self._shown: set[str] = set()
        self._lost = 0
        self._closed = False
        self._news = asyncio.Event()

    async def next_frames(self) -> Frames:
        """Wait for news and take all of it.

        Raises `StreamGapError` once an event did not fit, `StreamClosedError` after the close.
        """
        await self._news.wait()
        if self._lost:
            self.close()
            raise StreamGapError(self._lost)
        if self._closed:
            raise StreamClosedError
        self._news.clear()
        frames = Frames(tuple(self._events), tuple(self._outputs.values()))
        self._events.clear()
        self._outputs.clear()
        return frames

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Frames:
        try:
            return await self.next_frames()
        except StreamClosedError:
            raise StopAsyncIteration from None

    def close(self) -> None:
        """Stop listening; whoever waits in `next_frames` is released."""
        self._closed = True
        self._hub.unsubscribe(self)
        self._news.set()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def put_output(self, live: LiveOutput) -> None:
        """Put an output into its device's slot; an older one that waits there is replaced."""
        if not self._wanted.covers(live.site_id, live.device_id):
            return
        shows = self._wanted.shows(live.output)
        if not shows and live.device_id not in self._shown:
            return
        if shows:
            self._shown.add(live.device_id)
        else:
            self._shown.discard(live.device_id)
        self._outputs[live.device_id] = live
        self._news.set()

    def put_event(self, event: LiveEvent) -> None:
        """Queue an event; one too many ends the subscription with a gap."""
        if not self._wanted.covers(event.site_id, event.device_id):
            return
        if self._lost or len(self._events) >= self._max_events:
            self._lost += 1
        else:
            self._events.append(event)
        self._news.set()


class Hub:
    """Hands outputs and events to all subscriptions; never waits."""

    def __init__(self, max_events: int = 1000) -> None:
        # A browser that lags behind by more is better off with a fresh start.
        self._max_events = max_events
        self._subscriptions: set[Subscription] = set()
        self._event_ids = itertools.count(1)

    def subscribe(
        self, topics: Iterable[Topic], wanted: StreamFilter | None = None
    ) -> Subscription:
        """Start to listen; close the subscription (or leave its ``async with``) to stop."""
        subscription = Subscription(
            self, frozenset(topics), wanted or StreamFilter(), self._max_events
        )
        self._subscriptions.add(subscription)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Forget a subscription."""
        self._subscriptions.discard(subscription)

    def publish(self, site_id: str, device_id: str, output: Output) -> None:
        """Show a device's latest output."""
        live = LiveOutput(site_id, device_id, output)
        for subscription in self._subscriptions:
            if Topic.FIXES in subscription.topics:
                subscription.put_output(live)

    def publish_event(
        self,
        topic: Topic,
        content: object,
        site_id: str | None = None,
        device_id: str | None = None,
    ) -> None:
        """Tell everyone on a topic what happened."""
        event = LiveEvent(next(self._event_ids), topic, site_id, device_id, content)
        for subscription in self._subscriptions:
            if topic in subscription.topics:
                subscription.put_event(event)

    def close(self) -> None:
        """End all subscriptions: the server goes down."""
        for subscription in tuple(self._subscriptions):
            subscription.close()
