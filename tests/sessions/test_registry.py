"""What a phone is answered, and what happens to its session when things go wrong."""

import asyncio
from dataclasses import replace

import pytest
from session_ports import (
    START_S,
    ChainFold,
    ProcessDiedError,
    Server,
    batch_of,
    steps_at,
    straight_track,
)

from app.core.session import LogUnavailableError, Rejection
from app.core.types import NoFix
from app.sessions.batch import (
    BatchConflictError,
    ClockChangedError,
    ClockReport,
    MailboxFullError,
    UnknownSiteError,
)
from app.sessions.hub import Topic
from app.sessions.limits import SessionLimits

pytestmark = pytest.mark.anyio


async def _run_until_blocked() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_the_reply_carries_the_output_at_the_latest_observation() -> None:
    server = Server()
    edge = Rejection(7, "rssi_range")
    reply = await server.registry.submit(batch_of(steps_at(0.5, 2.25), rejected=(edge,), ignored=2))
    assert (reply.accepted, reply.rejected, reply.ignored) == (2, (edge,), 2)
    assert reply.output is not None
    assert reply.output.time_s == START_S + 2.25
    assert server.registry.latest("phone") == ("site", reply.output)
    assert server.registry.latest_at("site") == {"phone": reply.output}
    assert server.registry.latest("stranger") is None


async def test_a_batch_without_observations_is_kept_and_has_no_output() -> None:
    server = Server()
    rejected = (Rejection(0, "bad_unit"),)
    first = await server.registry.submit(batch_of([], rejected=rejected))
    again = await server.registry.submit(batch_of([], rejected=rejected))
    assert first.output is None
    assert again == replace(first, duplicate=True, observations=())
    assert server.registry.latest("phone") is None


async def test_the_same_batch_again_gets_the_stored_answer_and_is_folded_once() -> None:
    server = Server()
    first = await server.registry.submit(batch_of(steps_at(1.0, 2.0)))
    again = await server.registry.submit(batch_of(steps_at(1.0, 2.0), ignored=9))
    assert again == replace(first, duplicate=True, observations=())


async def test_an_old_batch_sent_again_is_no_reason_to_fold_the_log_again() -> None:
    server = Server()
    walk = steps_at(0.0, 1.0, 100.0, 101.5)
    await server.registry.submit(batch_of(walk[:2], 0))
    await server.registry.submit(batch_of(walk[2:], 1))
    assert (await server.registry.submit(batch_of(walk[:2], 0))).duplicate
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())
    assert server.log.reads == 1, "for the final track alone"


async def test_the_same_seq_with_other_records_is_a_conflict() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(1.0)))
    with pytest.raises(BatchConflictError):
        await server.registry.submit(batch_of(steps_at(2.0)))
    await server.run_idle()
    assert server.track() == straight_track(steps_at(1.0), ChainFold())


async def test_copies_of_a_batch_in_flight_are_folded_once() -> None:
    server = Server()
    copies = [server.registry.submit(batch_of(steps_at(1.0, 2.0))) for _ in range(5)]
    replies = await asyncio.gather(*copies)
    assert [reply.duplicate for reply in replies] == [False, True, True, True, True]
    assert {reply.output for reply in replies} == {replies[0].output}


async def test_batches_of_one_device_are_served_in_the_order_of_their_coming() -> None:
    server = Server()
    server.log.turns = lambda batch: 40 - 3 * batch.seq
    walk = steps_at(*range(12))
    replies = await asyncio.gather(
        *(server.registry.submit(batch_of([o], seq)) for seq, o in enumerate(walk))
    )
    times_s = [reply.output.time_s for reply in replies if reply.output]
    assert times_s == [o.time_s for o in walk]


async def test_a_full_mailbox_refuses_and_the_rest_is_served() -> None:
    server = Server(SessionLimits(mailbox_batches=3, retry_after_s=2.5))
    server.log.gate = asyncio.Event()
    waiting = [
        asyncio.create_task(server.registry.submit(batch_of(steps_at(i), i))) for i in range(3)
    ]
    await _run_until_blocked()
    with pytest.raises(MailboxFullError) as refused:
        await server.registry.submit(batch_of(steps_at(3), 3))
    assert refused.value.retry_after_s == 2.5
    other = asyncio.create_task(server.registry.submit(batch_of(steps_at(3), device_id="other")))
    await _run_until_blocked()
    server.log.gate.set()
    assert all(not reply.duplicate for reply in await asyncio.gather(*waiting, other))
    await server.registry.submit(batch_of(steps_at(3), 3))


async def test_a_caller_that_goes_away_leaves_a_folded_batch() -> None:
    server = Server()
    server.log.gate = asyncio.Event()
    caller = asyncio.create_task(server.registry.submit(batch_of(steps_at(0.5, 3.0))))
    await _run_until_blocked()
    caller.cancel()
    with pytest.raises(asyncio.CancelledError):
        await caller
    server.log.gate.set()
    reads = server.log.reads
    await server.registry.settle("phone")
    (pending,) = server.registry.pending_points("phone").values()
    points = {p.time_s: p for p in (*server.track(), *pending)}
    assert list(points.values()) == straight_track(steps_at(0.5, 3.0), ChainFold())
    assert server.log.reads == reads


async def test_what_the_log_refuses_is_neither_acknowledged_nor_folded() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(1.0), 0))
    before = server.registry.latest("phone")
    server.log.refusing = True
    with pytest.raises(LogUnavailableError):
        await server.registry.submit(batch_of(steps_at(2.0), 1))
    assert server.registry.latest("phone") == before
    server.log.refusing = False
    reply = await server.registry.submit(batch_of(steps_at(2.0), 1))
    assert not reply.duplicate
    assert reply.output is not None
    assert reply.output.time_s == START_S + 2.0


@pytest.mark.parametrize("phone_retries", [True, False])
async def test_a_write_that_landed_after_all_is_in_the_track(phone_retries: bool) -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(1.0), 0))
    server.log.refusing_after_commit = True
    with pytest.raises(LogUnavailableError):
        await server.registry.submit(batch_of(steps_at(2.5), 1))
    server.log.refusing_after_commit = False
    if phone_retries:
        reply = await server.registry.submit(batch_of(steps_at(2.5), 1))
        assert reply.duplicate
        assert reply.output is not None
        assert reply.output.time_s == START_S + 2.5
    await server.run_idle()
    observed = [*steps_at(1.0), *steps_at(2.5)]
    assert server.track() == straight_track(observed, ChainFold())


@pytest.mark.parametrize(
    "changed",
    [
        {"clock": ClockReport(recorded=True, boot_id="second")},
        {"clock": ClockReport(recorded=False, boot_id="first")},
        {"site_id": "other"},
    ],
)
async def test_a_batch_of_another_clock_or_site_does_not_belong_to_the_session(
    changed: dict[str, object],
) -> None:
    server = Server()
    server.sites.current = lambda site_id: server.sites.site  # type: ignore[method-assign]
    first = ClockReport(recorded=True, boot_id="first")
    await server.registry.submit(batch_of(steps_at(1.0), 0, clock=first))
    with pytest.raises(ClockChangedError):
        await server.registry.submit(batch_of(steps_at(2.0), 1, **{"clock": first, **changed}))
    without_boot = ClockReport(recorded=True)
    await server.registry.submit(batch_of(steps_at(2.0), 1, clock=without_boot))


async def test_an_unknown_site_is_refused_before_anything_is_logged() -> None:
    server = Server()
    with pytest.raises(UnknownSiteError):
        await server.registry.submit(batch_of(steps_at(1.0), site_id="nowhere"))
    assert server.log.sessions == {}


async def test_the_clock_is_frozen_by_the_first_batch() -> None:
    server = Server()
    first = ClockReport(sent_s=START_S - 100, mono_s=50.0)
    late = ClockReport(sent_s=START_S - 7, mono_s=0.0)
    observed = steps_at(-100.5)
    await server.registry.submit(batch_of(observed, 0, clock=first))
    reply = await server.registry.submit(batch_of(steps_at(-99.0), 1, clock=late))
    assert reply.output is not None
    assert reply.output.time_s == START_S + 1.0


async def test_a_fold_that_fails_starts_from_the_log_again() -> None:
    server = Server()
    walk = steps_at(*range(10), 10.5)
    await server.registry.submit(batch_of(walk[:4], 0))
    fold = server.registry._ports.fold
    advance = fold.advance

    def fail_at_six(state: object, observation: object, *world: object) -> object:
        if observation.time_s == START_S + 6:  # type: ignore[attr-defined]
            raise ProcessDiedError
        return advance(state, observation, *world)  # type: ignore[arg-type]

    fold.advance = fail_at_six  # type: ignore[method-assign, assignment]
    with pytest.raises(ProcessDiedError):
        await server.registry.submit(batch_of(walk[4:], 1))
    fold.advance = advance  # type: ignore[method-assign]
    reply = await server.registry.submit(batch_of(walk[4:], 1))
    assert reply.duplicate
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())


async def test_a_site_that_goes_away_takes_its_sessions_along() -> None:
    server = Server()
    await server.registry.submit(batch_of(steps_at(1.0)))
    server.sites.site = None
    await server.registry.settle("phone")
    assert server.registry.pending_points("phone") == {}
    await server.run_idle()
    with pytest.raises(UnknownSiteError):
        await server.registry.submit(batch_of(steps_at(2.0), 1))


async def test_two_sessions_of_a_phone_have_two_tracks() -> None:
    server = Server()
    first, second = steps_at(1.0, 2.5), steps_at(31.0, 33.5)
    await server.registry.submit(batch_of(first, 0, session="first"))
    await server.registry.submit(batch_of(second, 0, session="second"))
    await server.run_idle()
    assert server.track("first") == straight_track(first, ChainFold())
    assert server.track("second") == straight_track(second, ChainFold())


async def test_listeners_see_what_the_reply_says() -> None:
    server = Server()
    async with server.hub.subscribe([Topic.FIXES]) as subscription:
        reply = await server.registry.submit(batch_of(steps_at(1.0, 2.5)))
        frames = await subscription.next_frames()
        assert [live.output for live in frames.outputs] == [reply.output]
        await server.registry.submit(batch_of(steps_at(1.0, 2.5)))
        waiting = asyncio.create_task(subscription.next_frames())
        await _run_until_blocked()
        assert not waiting.done(), "a duplicate is no news"
        waiting.cancel()


async def test_absence_is_published_too() -> None:
    server = Server()
    async with server.hub.subscribe([Topic.FIXES]) as subscription:
        outputs = []
        for seq, observation in enumerate(steps_at(*range(30))):
            await server.registry.submit(batch_of([observation], seq))
            outputs += [live.output for live in (await subscription.next_frames()).outputs]
    assert len(outputs) == 30
    assert any(isinstance(output, NoFix) for output in outputs)
