"""From the first snapshot to the final track: sleep, restart, end, and coming back."""

import asyncio
from dataclasses import replace

import pytest
from session_ports import START_S, ChainFold, Server, batch_of, steps_at, straight_track

from app.core.session import LogUnavailableError
from app.sessions.batch import SessionOverError
from app.sessions.limits import SessionLimits

pytestmark = pytest.mark.anyio


async def test_snapshots_are_taken_at_their_pace() -> None:
    server = Server(SessionLimits(snapshot_every_s=30.0))
    for seq, observation in enumerate(steps_at(*range(100))):
        await server.registry.submit(batch_of([observation], seq))
    assert server.history.saved == 4


async def test_a_silent_session_sleeps_in_its_snapshot_and_wakes_without_refolding() -> None:
    server = Server()
    walk = steps_at(*range(100), 100.5)
    await server.registry.submit(batch_of(walk[:60], 0))
    server.clock.time_s += server.limits.evict_s
    await server.registry.sweep()
    assert server.registry.pending_points("phone") == {}
    (read_since,) = await _reads_of(server, batch_of(walk[60:], 1))
    assert read_since is not None
    assert read_since > START_S + 50
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())
    assert server.log.reads == 2, "one to wake up, one for the final track"


async def _reads_of(server: Server, batch: object) -> list[float | None]:
    reads: list[float | None] = []
    read = server.log.read

    async def watch(session_id: str, since_s: float | None = None) -> object:
        reads.append(since_s)
        return await read(session_id, since_s)

    server.log.read = watch  # type: ignore[assignment, method-assign]
    await server.registry.submit(batch)  # type: ignore[arg-type]
    server.log.read = read  # type: ignore[method-assign]
    return reads


async def test_too_many_sessions_send_the_longest_silent_to_sleep() -> None:
    server = Server(SessionLimits(max_sessions=2))
    for i in range(4):
        server.clock.time_s += 1
        await server.registry.submit(batch_of(steps_at(1.0), device_id=f"phone-{i}"))
    await server.registry.sweep()
    awake = [i for i in range(4) if server.registry.pending_points(f"phone-{i}")]
    assert awake == [2, 3]


async def test_unfinished_sessions_of_an_earlier_process_are_finished_when_idle() -> None:
    server = Server()
    walk = steps_at(*range(10), 10.5)
    await server.registry.submit(batch_of(walk))
    await server.kill(written=0)
    await server.registry.sweep()
    assert not server.log.sessions["phone", "walk"].finished
    await server.run_idle()
    assert server.log.sessions["phone", "walk"].finished
    assert server.track() == straight_track(walk, ChainFold())


@pytest.mark.parametrize("killed", [True, False])
async def test_a_phone_that_comes_back_to_a_finished_session_opens_it_again(killed: bool) -> None:
    server = Server()
    walk = steps_at(*range(10), 10.5, *range(600, 610), 610.25, 4.5)
    await server.registry.submit(batch_of(walk[:11], 0))
    await server.run_idle()
    assert server.log.sessions["phone", "walk"].finished
    await server.registry.submit(batch_of(walk[11:], 1))
    assert not server.log.sessions["phone", "walk"].finished
    if killed:
        await server.kill(written=1)
    await server.run_idle()
    assert server.log.sessions["phone", "walk"].finished
    assert server.track() == straight_track(walk, ChainFold())


async def test_a_session_finished_long_ago_stays_finished() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(*range(10)), 0))
    await server.run_idle()
    stored = server.track()
    later_s = START_S + server.limits.reopen_s + 1
    with pytest.raises(SessionOverError):
        await server.registry.submit(batch_of(steps_at(600), 1, received_s=later_s))
    assert server.log.sessions["phone", "walk"].finished
    assert server.track() == stored


async def test_a_finish_that_fails_leaves_no_stale_end_point() -> None:
    server = Server()
    walk = steps_at(*range(10), 10.5, 11.25)
    await server.registry.submit(batch_of(walk[:11], 0))
    finish = server.log.finish_session

    async def refuse(session_id: str) -> None:
        raise LogUnavailableError(session_id)

    server.log.finish_session = refuse  # type: ignore[method-assign]
    await server.run_idle()
    assert server.track()[-1].time_s == START_S + 10.5
    server.log.finish_session = finish  # type: ignore[method-assign]
    await server.registry.submit(batch_of(walk[11:], 1))
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())


async def test_a_closed_registry_has_stored_everything() -> None:
    server = Server()
    walk = steps_at(*range(20), 20.5)
    await server.registry.submit(batch_of(walk))
    await server.registry.close()
    assert server.history.queue == []
    assert len(server.history.snapshots) == 1
    await server.kill(written=0)
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())


async def test_what_is_over_leaves_memory() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(1.0)))
    await server.run_idle()
    assert server.registry._devices == {}


async def test_a_phone_that_is_back_before_the_finish_has_its_turn_keeps_its_session_open() -> None:
    server = Server()
    walk = steps_at(*range(10), 10.5, *range(600, 610), 610.25)
    await server.registry.submit(batch_of(walk[:11], 0))
    server.clock.time_s += server.limits.idle_s
    submitted = server.registry.submit(batch_of(walk[11:], 1))
    await asyncio.gather(submitted, server.registry.sweep())
    assert not server.log.sessions["phone", "walk"].finished
    assert server.registry.pending_points("phone")
    await server.run_idle()
    assert server.log.sessions["phone", "walk"].finished
    assert server.track() == straight_track(walk, ChainFold())


async def test_a_device_erased_before_the_finish_has_its_turn_stays_erased(
    caplog: pytest.LogCaptureFixture,
) -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(*range(10))))
    server.clock.time_s += server.limits.idle_s

    async def remove() -> None:
        server.log.sessions.clear()
        server.history.tracks.clear()
        server.history.queue.clear()

    await asyncio.gather(server.registry.erase("phone", remove), server.registry.sweep())
    assert caplog.text == ""
    assert server.history.tracks == {}


async def test_trouble_with_history_does_not_stop_the_phone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    server = Server()
    walk = steps_at(*range(100), 100.5)
    server.history.refusing = True
    for seq, observation in enumerate(walk):
        reply = await server.registry.submit(batch_of([observation], seq))
        assert reply.output is not None
    server.clock.time_s += server.limits.idle_s
    await server.registry.sweep()
    assert "device phone" in caplog.text
    assert not server.log.sessions["phone", "walk"].finished
    server.history.refusing = False
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())


async def test_after_a_restart_each_device_is_where_its_newest_session_ended() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(*range(20)), session="first"))
    server.clock.time_s += 1
    # A recording of yesterday, posted today, is the newest there is.
    yesterday = [replace(o, time_s=o.time_s - 86_400.0) for o in steps_at(*range(30))]
    await server.registry.submit(batch_of(yesterday, session="second", received_s=START_S + 1))
    await server.registry.submit(batch_of(steps_at(*range(9)), device_id="other"))
    await server.registry.submit(batch_of([], device_id="silent"))
    await server.kill(written=99)
    assert server.registry.latest("phone") == ("site", server.track("second")[-1])
    assert server.registry.latest_at("site") == {
        "phone": server.track("second")[-1],
        "other": server.track(device_id="other")[-1],
    }
    reply = await server.registry.submit(batch_of(steps_at(25.0), 1, session="first"))
    assert server.registry.latest("phone") == ("site", reply.output)
