"""However a walk's observations reach the server, the stored track is the same, bit for bit."""

import asyncio
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_ports import (
    START_S,
    ChainFold,
    ProcessDiedError,
    Server,
    batch_of,
    steps_at,
    straight_track,
)

from app.core.types import ImuBlock, Observation, Reading, Steps, WifiScan
from app.sessions.limits import SessionLimits

QUARTERS = st.integers(0, 160).map(lambda quarter: START_S + quarter / 4)


def _imu_block(time_s: float, samples: int) -> ImuBlock:
    acc_mps2 = np.full((samples, 3), samples, dtype=np.float32)
    none = np.empty((0, 3), dtype=np.float32)
    return ImuBlock(time_s, 10.0, acc_mps2, none, none, np.empty((0, 4), dtype=np.float32))


OBSERVATIONS: st.SearchStrategy[Observation] = st.one_of(
    st.builds(Steps, QUARTERS, st.integers(1, 3)),
    st.builds(WifiScan, QUARTERS, st.just((Reading(("mac:020000000001",), -60.0),))),
    st.builds(_imu_block, QUARTERS, st.integers(1, 30)),
)
WALKS = st.lists(OBSERVATIONS, min_size=1, max_size=40)


@dataclass(frozen=True)
class Delivery:
    """What happens around one batch on its way."""

    copies: int
    killed_before_fold: bool
    killed_after: int | None
    put_to_sleep: bool
    settled: bool


DELIVERIES = st.builds(
    Delivery,
    copies=st.integers(1, 2),
    killed_before_fold=st.booleans(),
    killed_after=st.none() | st.integers(0, 20),
    put_to_sleep=st.booleans(),
    settled=st.booleans(),
)


def _cut(observations: list[Observation], cuts: list[int]) -> list[list[Observation]]:
    bounds = [0, *sorted(c % (len(observations) + 1) for c in cuts), len(observations)]
    return [observations[a:b] for a, b in itertools.pairwise(bounds) if b > a]


async def _deliver(
    server: Server, seq: int, observations: list[Observation], way: Delivery
) -> None:
    batch = batch_of(observations, seq)
    if way.killed_before_fold:
        server.log.dying_after_commit = True
        with pytest.raises(ProcessDiedError):
            await server.registry.submit(batch)
        server.log.dying_after_commit = False
        await server.kill(written=len(server.history.queue) // 2)
    for _ in range(way.copies):
        await server.registry.submit(batch)
    if way.killed_after is not None:
        await server.kill(way.killed_after)
    if way.put_to_sleep:
        server.clock.time_s += server.limits.evict_s
        await server.registry.sweep()
    if way.settled:
        await server.registry.settle("phone")


@settings(max_examples=150, deadline=None)
@given(walk=WALKS, data=st.data())
def test_any_order_grouping_repetition_and_crash_gives_the_same_track(
    walk: list[Observation], data: st.DataObject
) -> None:
    arriving = data.draw(st.permutations(walk))
    groups = _cut(arriving, data.draw(st.lists(st.integers(0, 40), max_size=6)))
    ways = data.draw(st.lists(DELIVERIES, min_size=len(groups), max_size=len(groups)))

    async def run() -> Server:
        server = Server(SessionLimits(snapshot_every_s=6.0, fold_chunk=4))
        for seq, (group, way) in enumerate(zip(groups, ways, strict=True)):
            await _deliver(server, seq, group, way)
        await server.run_idle()
        return server

    server = asyncio.run(run())
    assert server.track() == straight_track(walk, ChainFold())
    assert server.log.sessions["phone", "walk"].finished


@settings(max_examples=150, deadline=None)
@given(walk=WALKS, data=st.data())
def test_what_is_late_inside_the_window_is_folded_in_at_once(
    walk: list[Observation], data: st.DataObject
) -> None:
    delays_s = data.draw(
        st.lists(st.floats(0, 4.9), min_size=len(walk), max_size=len(walk)), label="delays"
    )
    late = sorted(zip(walk, delays_s, strict=True), key=lambda pair: pair[0].time_s + pair[1])
    groups = _cut([o for o, _ in late], data.draw(st.lists(st.integers(0, 40), max_size=8)))

    async def run() -> Server:
        server = Server()
        for seq, group in enumerate(groups):
            await server.registry.submit(batch_of(group, seq))
        await server.run_idle()
        return server

    server = asyncio.run(run())
    assert server.track() == straight_track(walk, ChainFold())
    assert server.log.reads == 1, "the log was folded again although nothing was too late"


@settings(max_examples=80, deadline=None)
@given(walk=WALKS, data=st.data())
def test_after_settling_stored_and_pending_points_are_the_exact_track_so_far(
    walk: list[Observation], data: st.DataObject
) -> None:
    arriving = data.draw(st.permutations(walk))
    groups = _cut(arriving, data.draw(st.lists(st.integers(0, 40), max_size=6)))

    async def run() -> None:
        server = Server()
        so_far: list[Observation] = []
        for seq, group in enumerate(groups):
            await server.registry.submit(batch_of(group, seq))
            so_far += group
            if data.draw(st.booleans()):
                await server.kill(data.draw(st.integers(0, 5)))
            await server.registry.settle("phone")
            (pending,) = server.registry.pending_points("phone").values()
            points = {p.time_s: p for p in (*server.track(), *pending)}
            assert [points[t] for t in sorted(points)] == straight_track(so_far, ChainFold())

    asyncio.run(run())


@pytest.mark.anyio
async def test_a_late_observation_corrects_the_points_already_stored() -> None:
    server = Server()
    walk = steps_at(0.5, 1.5, 2.5, 3.5, 1.75)
    await server.registry.submit(batch_of(walk[:4], 0))
    await server.registry.submit(batch_of(walk[4:], 1))
    await server.history.flush()
    wanted = straight_track(walk, ChainFold())
    assert server.track() == [p for p in wanted if p.time_s.is_integer()]


@pytest.mark.anyio
async def test_an_observation_older_than_the_window_waits_for_the_settling() -> None:
    server = Server()
    walk = steps_at(*range(20), 3.5)
    await server.registry.submit(batch_of(walk[:20], 0))
    reply = await server.registry.submit(batch_of(walk[20:], 1))
    assert reply.accepted == 1
    await server.history.flush()
    without = server.track()
    assert without == [p for p in straight_track(walk[:20], ChainFold()) if p in without]
    await server.registry.settle("phone")
    wanted = straight_track(walk, ChainFold())
    assert server.track() == wanted[: len(server.track())]
    assert server.track() != without


@pytest.mark.anyio
@pytest.mark.parametrize("count", range(8))
async def test_recovery_corrects_what_the_dead_process_stored(count: int) -> None:
    server = Server()
    walk = [*steps_at(*range(10)), Steps(START_S + 6.5, count)]
    await server.registry.submit(batch_of(walk[:10], 0))
    server.log.dying_after_commit = True
    with pytest.raises(ProcessDiedError):
        await server.registry.submit(batch_of(walk[10:], 1))
    server.log.dying_after_commit = False
    await server.kill(written=100)
    await server.registry.submit(batch_of(walk[10:], 1))
    await server.history.flush()
    assert server.track() == [
        p for p in straight_track(walk, ChainFold()) if p.time_s < START_S + 9
    ]


@pytest.mark.anyio
async def test_a_long_refolding_lets_others_run() -> None:
    server = Server(SessionLimits(fold_chunk=8))
    await server.registry.submit(batch_of(steps_at(*range(400)), 0))
    await server.kill(written=0)
    settling = asyncio.create_task(server.registry.settle("phone"))
    turns = 0
    while not settling.done():
        turns += 1
        await asyncio.sleep(0)
    assert turns >= 400 / 8 * 3, "sorting gives way twice, folding once"
