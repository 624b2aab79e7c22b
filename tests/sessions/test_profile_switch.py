"""A live session changes its profile as if it had always had it; what was told stays told."""

import asyncio
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_ports import (
    SITE,
    START_S,
    ChainFold,
    OneSite,
    ProcessDiedError,
    Server,
    batch_of,
    steps_at,
    straight_track,
)

from app.core.session import LogUnavailableError
from app.core.types import Observation, Output, TrackPoint
from app.sessions.limits import SessionLimits

pytestmark = pytest.mark.anyio

WALK = steps_at(*(0.5 + i for i in range(40)))


def told_with(profile: str, walk: list[Observation] = WALK) -> list[TrackPoint]:
    return straight_track(walk, ChainFold(), profile)


def answer_with(profile: str, walk: list[Observation]) -> Output:
    fold, params = ChainFold(), OneSite().params(SITE.site_id, profile)
    state = fold.start()
    for observation in walk:
        state, _ = fold.advance(state, observation, SITE, params)
    return fold.finish(state, SITE, params)[-1]


def joined(before: list[TrackPoint], after: list[TrackPoint], since_s: float) -> list[TrackPoint]:
    kept = [p for p in before if p.time_s < since_s]
    return kept + [p for p in after if p.time_s >= since_s]


async def post(server: Server, profile: str, begin: int, end: int, **fields: object) -> object:
    """Post the steps from one to the other, in a batch of each; return the last answer's output."""
    answer = None
    for seq in range(begin, end):
        batch = batch_of(WALK[seq : seq + 1], seq, profile=profile, **fields)
        answer = (await server.registry.submit(batch)).output
    return answer


async def live_track(server: Server) -> list[TrackPoint]:
    (track,) = (await server.live_tracks("phone")).values()
    return track


async def finish(server: Server) -> list[TrackPoint]:
    server.clock.time_s += server.limits.idle_s
    await server.registry.sweep()
    return server.track()


async def test_the_next_answer_is_of_the_new_profile_and_what_was_told_stays() -> None:
    server = Server()
    await post(server, "best", 0, 20)
    output = await post(server, "other", 20, 30)
    now = WALK[:30]
    assert output == answer_with("other", now)
    assert server.registry.latest("phone") == ("site", output)
    since_s = WALK[19].time_s
    expected = joined(told_with("best", now), told_with("other", now), since_s)
    assert await live_track(server) == expected
    assert expected != told_with("other", now)
    await post(server, "other", 30, 40)
    assert await finish(server) == told_with("other")


async def test_a_session_that_named_its_profile_keeps_it() -> None:
    server = Server()
    await post(server, "best", 0, 10, named_profile="named")
    await post(server, "other", 10, 40)
    assert await live_track(server) == told_with("named")


async def test_what_came_late_before_the_switch_is_in_what_stays_and_later_in_the_end() -> None:
    server = Server()
    late, very_late = WALK[3], WALK[4]
    early = [o for o in WALK[:20] if o not in (late, very_late)]
    await server.registry.submit(batch_of(early, 0))
    await server.registry.submit(batch_of([late], 1))
    await server.registry.submit(batch_of(WALK[20:30], 2, profile="other"))
    await server.registry.submit(batch_of([very_late], 3, profile="other"))
    before = told_with("best", sorted([*early, late], key=lambda o: o.time_s))
    expected = joined(before, told_with("other", WALK[:30]), WALK[19].time_s)
    assert await live_track(server) == expected
    assert await finish(server) == told_with("other", WALK[:30])


@pytest.mark.parametrize("written", [0, 3, 1000])
async def test_a_crash_after_the_switch_changes_nothing(written: int) -> None:
    server = Server(SessionLimits(snapshot_every_s=6.0))
    await post(server, "best", 0, 20)
    await post(server, "other", 20, 22)
    await server.kill(written)
    await post(server, "other", 22, 30)
    now = WALK[:30]
    since_s = WALK[19].time_s
    expected = joined(told_with("best", now), told_with("other", now), since_s)
    assert await live_track(server) == expected
    # Back again, across another crash, before anything else is posted.
    await post(server, "best", 29, 30)
    await server.kill(written)
    await post(server, "best", 30, 40)
    live = await live_track(server)
    assert live == joined(expected, told_with("best"), WALK[29].time_s)
    assert await finish(server) == told_with("best")


async def test_a_snapshot_of_another_profile_is_not_used() -> None:
    server = Server(SessionLimits(snapshot_every_s=6.0))
    await post(server, "best", 0, 20)
    server.clock.time_s += server.limits.evict_s
    await server.registry.sweep()
    saved = dict(server.history.snapshots)
    await post(server, "other", 20, 21)
    server.history.snapshots = saved
    await server.kill(1000)
    output = await post(server, "other", 21, 22)
    assert output == answer_with("other", WALK[:22])


async def test_a_switch_that_cannot_be_stored_is_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server = Server()
    await post(server, "best", 0, 20)

    async def refuse(record: object) -> None:
        raise LogUnavailableError

    with monkeypatch.context() as patch:
        patch.setattr(server.log, "switch_profile", refuse)
        with pytest.raises(LogUnavailableError):
            await post(server, "other", 20, 21)
    await post(server, "other", 20, 40)
    since_s = WALK[19].time_s
    assert await live_track(server) == joined(told_with("best"), told_with("other"), since_s)


@dataclass(frozen=True)
class Turn:
    """What happens to one batch: with which profile it comes, and whether the server dies."""

    profile: str
    killed_before_fold: bool
    killed_after: int | None
    put_to_sleep: bool


TURNS = st.builds(
    Turn,
    profile=st.sampled_from(["best", "other"]),
    killed_before_fold=st.booleans(),
    killed_after=st.none() | st.integers(0, 20),
    put_to_sleep=st.booleans(),
)


async def _post(server: Server, seq: int, observations: list[Observation], turn: Turn) -> None:
    batch = batch_of(observations, seq, profile=turn.profile)
    if turn.killed_before_fold:
        server.log.dying_after_commit = True
        with pytest.raises(ProcessDiedError):
            await server.registry.submit(batch)
        server.log.dying_after_commit = False
        await server.kill(written=len(server.history.queue) // 2)
    await server.registry.submit(batch)
    if turn.killed_after is not None:
        await server.kill(turn.killed_after)
    if turn.put_to_sleep:
        server.clock.time_s += server.limits.evict_s
        await server.registry.sweep()


@settings(max_examples=100, deadline=None)
@given(turns=st.lists(TURNS, min_size=1, max_size=8), data=st.data())
def test_whatever_happens_between_the_track_is_of_the_profile_of_the_time(
    turns: list[Turn], data: st.DataObject
) -> None:
    sizes = data.draw(st.lists(st.integers(1, 6), min_size=len(turns), max_size=len(turns)))

    async def run() -> None:
        server = Server(SessionLimits(snapshot_every_s=6.0, fold_chunk=4))
        posted: list[Observation] = []
        segments: list[tuple[str, float]] = []
        for seq, (turn, size) in enumerate(zip(turns, sizes, strict=True)):
            if not segments or segments[-1][0] != turn.profile:
                since_s = posted[-1].time_s if posted else START_S
                segments.append((turn.profile, since_s))
            group = WALK[len(posted) : len(posted) + size]
            await _post(server, seq, group, turn)
            posted += group
        expected: list[TrackPoint] = []
        for profile, since_s in segments:
            expected = joined(expected, told_with(profile, posted), since_s)
        assert await live_track(server) == expected
        assert await finish(server) == told_with(turns[-1].profile, posted)

    asyncio.run(run())
