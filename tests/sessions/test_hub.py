"""What listeners get: the newest position of each device, every event, or a gap."""

import asyncio
import gc
import weakref
from dataclasses import replace

import pytest
from session_ports import START_S, ChainFold, steps_at, straight_track

from app.core.types import NoFix, NoFixReason, TrackPoint
from app.sessions.hub import Frames, Hub, StreamClosedError, StreamFilter, StreamGapError, Topic

pytestmark = pytest.mark.anyio

POINT = straight_track(steps_at(*range(9)), ChainFold())[0]


def _point(second: int, floor_id: str = "floor") -> TrackPoint:
    return replace(POINT, time_s=START_S + second, floor_id=floor_id)


def _shown(frames: Frames) -> dict[str, float]:
    return {live.device_id: live.output.time_s - START_S for live in frames.outputs}


async def test_a_stalled_listener_loses_only_its_own_older_points() -> None:
    hub = Hub()
    stalled, prompt = hub.subscribe([Topic.FIXES]), hub.subscribe([Topic.FIXES])
    for second in range(3):
        hub.publish("site", "a", _point(second))
        hub.publish("site", "b", _point(second))
        assert _shown(await prompt.next_frames()) == {"a": second, "b": second}
    assert _shown(await stalled.next_frames()) == {"a": 2, "b": 2}


async def test_news_wakes_a_waiting_listener() -> None:
    hub = Hub()
    listening = asyncio.create_task(hub.subscribe([Topic.FIXES]).next_frames())
    await asyncio.sleep(0)
    assert not listening.done()
    hub.publish("site", "a", _point(1))
    assert _shown(await listening) == {"a": 1}


async def test_listeners_get_their_topics_sites_and_devices() -> None:
    hub = Hub()
    hall = hub.subscribe([Topic.FIXES, Topic.DEVICES], StreamFilter(site_id="hall"))
    one = hub.subscribe([Topic.FIXES], StreamFilter(device_ids=frozenset({"b"})))
    hub.publish("hall", "a", _point(1))
    hub.publish("yard", "b", _point(2))
    hub.publish_event(Topic.DEVICES, "sos", site_id="hall", device_id="a")
    hub.publish_event(Topic.DEVICES, "elsewhere", site_id="yard")
    hub.publish_event(Topic.DEVICES, "everywhere")
    hub.publish_event(Topic.JOBS, "other topic", site_id="hall")
    frames = await hall.next_frames()
    assert _shown(frames) == {"a": 1}
    assert [event.content for event in frames.events] == ["sos", "everywhere"]
    assert frames.events[0].event_id < frames.events[1].event_id
    assert _shown(await one.next_frames()) == {"b": 2}


async def test_a_device_that_leaves_the_floor_is_shown_once_more() -> None:
    hub = Hub()
    floor = hub.subscribe([Topic.FIXES], StreamFilter(floor_id="floor"))
    hub.publish("site", "elsewhere", _point(0, "upstairs"))
    hub.publish("site", "a", _point(1))
    hub.publish("site", "b", _point(1))
    assert _shown(await floor.next_frames()) == {"a": 1, "b": 1}
    for second in (2, 3):
        hub.publish("site", "a", _point(second, "upstairs"))
        hub.publish("site", "b", NoFix(START_S + second, NoFixReason.NOTHING_HEARD))
    assert _shown(await floor.next_frames()) == {"a": 2, "b": 2}


async def test_events_are_never_dropped_silently() -> None:
    hub = Hub(max_events=3)
    slow, prompt = hub.subscribe([Topic.DEVICES]), hub.subscribe([Topic.DEVICES])
    for i in range(5):
        hub.publish_event(Topic.DEVICES, i)
        await prompt.next_frames()
    with pytest.raises(StreamGapError) as gap:
        await slow.next_frames()
    assert gap.value.lost == 2
    hub.publish_event(Topic.DEVICES, 5)
    assert [e.content for e in (await prompt.next_frames()).events] == [5]


async def test_a_closed_subscription_hears_nothing_and_releases_its_reader() -> None:
    hub = Hub()
    async with hub.subscribe([Topic.FIXES]) as subscription:
        reading = asyncio.create_task(subscription.next_frames())
        await asyncio.sleep(0)
    with pytest.raises(StreamClosedError):
        await reading
    hub.publish("site", "a", _point(1))
    with pytest.raises(StreamClosedError):
        await subscription.next_frames()


async def test_the_hub_forgets_closed_subscriptions() -> None:
    hub = Hub()
    async with hub.subscribe([Topic.FIXES]) as subscription:
        there = weakref.ref(subscription)
    del subscription
    gc.collect()
    assert there() is None


async def test_a_closing_hub_ends_every_iteration() -> None:
    hub = Hub()
    subscription = hub.subscribe([Topic.FIXES])
    seen = []
    hub.publish("site", "a", _point(1))
    async for frames in subscription:
        seen.append(_shown(frames))
        hub.close()
    assert seen == [{"a": 1}]
