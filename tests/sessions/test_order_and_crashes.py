"""However a walk's observations reach the server, the stored track is the same, bit for bit."""

import asyncio
import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from session_ports import (
    PARAMS,
    SITE,
    START_S,
    ChainFold,
    ProcessDiedError,
    Server,
    batch_of,
    steps_at,
    straight_track,
)

from app.core.types import ImuBlock, Observation, Reading, Steps, WifiScan
from app.sessions.batch import ClockReport, IncomingBatch, IncomingRecord
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


PLAIN = Delivery(1, False, None, False, False)


def _cut(observations: list[Observation], cuts: list[int]) -> list[list[Observation]]:
    bounds = [0, *sorted(c % (len(observations) + 1) for c in cuts), len(observations)]
    return [observations[a:b] for a, b in itertools.pairwise(bounds) if b > a]


async def _deliver(server: Server, batch: IncomingBatch, way: Delivery) -> None:
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
            await _deliver(server, batch_of(group, seq), way)
        await server.run_idle()
        return server

    server = asyncio.run(run())
    assert server.track() == straight_track(walk, ChainFold())
    assert server.log.sessions["phone", "walk"].finished


BOOTED_S = START_S - 500.0
"""When the phone's monotonic clock began to count, by its wall clock."""


@dataclass(frozen=True)
class Told:
    """What one batch's clock block tells: the wall clock, read so long after the monotonic one."""

    jitter_s: float | None
    wall_off_s: float = 0.0

    def report(self) -> ClockReport:
        if self.jitter_s is None:
            return ClockReport()
        sent_s = START_S + self.jitter_s - self.wall_off_s
        return ClockReport(sent_s=sent_s, mono_s=START_S - BOOTED_S)


JITTERS = st.integers(-60, 60).map(lambda ms: ms / 1000)
BLOCKS = st.one_of(
    st.lists(st.builds(Told, JITTERS), min_size=7, max_size=7),
    st.lists(st.builds(Told, JITTERS | st.none()), min_size=7, max_size=7),
    st.lists(st.builds(Told, JITTERS, st.just(90.0)), min_size=7, max_size=7),
    JITTERS.map(lambda jitter_s: [Told(jitter_s)] + [Told(None)] * 6),
    JITTERS.map(lambda jitter_s: [Told(None)] * 3 + [Told(jitter_s)] * 4),
)


def _shifted(observation: Observation, by_s: float) -> Observation:
    return replace(observation, time_s=round(observation.time_s + by_s, 6))


def _records(
    observations: list[Observation], wall_timed: set[int], wall_off_s: float
) -> tuple[IncomingRecord, ...]:
    return tuple(
        IncomingRecord(i, _shifted(o, -wall_off_s))
        if i in wall_timed
        else IncomingRecord(i, _shifted(o, -BOOTED_S), monotonic=True)
        for i, o in enumerate(observations)
    )


@settings(max_examples=200, deadline=None)
@given(walk=WALKS, blocks=BLOCKS, data=st.data())
def test_no_order_of_batches_moves_the_times_of_a_monotonic_clock(
    walk: list[Observation], blocks: list[Told], data: st.DataObject
) -> None:
    """Each batch tells its clocks with another jitter, or only some tell them at all."""
    groups = _cut(walk, data.draw(st.lists(st.integers(0, 40), max_size=6)))
    teller = next((told for told in blocks[: len(groups)] if told.jitter_s is not None), None)
    assume(teller is not None)
    assert teller is not None
    off_s = teller.wall_off_s
    wall_timed = data.draw(st.sets(st.integers(0, 5)), label="by the wall clock")
    posted = [
        batch_of(group, seq, records=_records(group, wall_timed, off_s), clock=told.report())
        for seq, (group, told) in enumerate(zip(groups, blocks, strict=False))
    ]
    arriving = data.draw(st.permutations(posted), label="arriving")
    ways = data.draw(st.lists(DELIVERIES, min_size=len(groups), max_size=len(groups)))

    async def run(batches: list[IncomingBatch], ways: list[Delivery]) -> Server:
        server = Server(SessionLimits(snapshot_every_s=6.0, fold_chunk=4))
        for batch, way in zip(batches, ways, strict=True):
            await _deliver(server, batch, way)
        await server.run_idle()
        return server

    server = asyncio.run(run(arriving, ways))
    plain = asyncio.run(run(posted, [PLAIN] * len(posted)))
    assert server.track() == plain.track()
    assert server.log.sessions["phone", "walk"].finished
    if off_s == 0.0:
        timed = [
            o if i in wall_timed else _shifted(o, teller.jitter_s or 0.0)
            for group in groups
            for i, o in enumerate(group)
        ]
        assert server.track() == straight_track(timed, ChainFold())


@pytest.mark.anyio
async def test_swapping_the_first_two_batches_changes_no_reply_after_them() -> None:
    jitters_s = (0.0, 0.031, 0.017)
    posted = [
        batch_of(
            [],
            seq,
            records=_records(list(steps_at(seq + 0.25, seq + 0.75)), set(), 0.0),
            clock=Told(jitter_s).report(),
        )
        for seq, jitter_s in enumerate(jitters_s)
    ]
    replies = []
    for order in ((0, 1, 2), (1, 0, 2)):
        server = Server()
        told = [await server.registry.submit(posted[seq]) for seq in order]
        replies.append(replace(told[-1], session_id=""))
    assert replies[0] == replies[1]


@pytest.mark.anyio
@pytest.mark.parametrize("killed", [False, True])
async def test_records_wait_for_the_batch_that_tells_their_clock(killed: bool) -> None:
    server = Server()
    walk = list(steps_at(1.25, 2.5, 3.75))
    records = _records(walk, set(), 0.0)
    late = batch_of([], 1, records=records[1:], clock=ClockReport())
    reply = await server.registry.submit(late)
    assert (reply.accepted, reply.waiting, reply.rejected) == (2, 2, ())
    assert reply.output is None
    if killed:
        await server.kill(written=0)
    told = batch_of([], 0, records=records[:1], clock=Told(0.0).report())
    reply = await server.registry.submit(told)
    assert (reply.accepted, reply.waiting) == (1, 0)
    assert reply.output is not None
    assert reply.output.time_s == walk[-1].time_s
    again = await server.registry.submit(late)
    assert (again.accepted, again.waiting, again.duplicate) == (2, 0, True)
    await server.run_idle()
    assert server.track() == straight_track(walk, ChainFold())


@pytest.mark.anyio
async def test_a_clock_that_is_never_told_is_refused_after_a_minute() -> None:
    server = Server()
    records = _records(list(steps_at(1.0)), set(), 0.0)
    for seq, after_s in enumerate((0.0, 59.0, 61.0)):
        batch = batch_of(
            [], seq, records=records, clock=ClockReport(), received_s=START_S + after_s
        )
        reply = await server.registry.submit(batch)
    assert [(r.index, r.code) for r in reply.rejected] == [(0, "no_clock")]
    await server.run_idle()
    assert server.track() == []


@pytest.mark.anyio
async def test_a_lower_seq_long_after_the_start_counts_when_the_session_is_settled() -> None:
    """An upload from the newest batch to the oldest does not fold all again for each of them."""
    server = Server()
    walk = list(steps_at(*range(30)))
    posted = [
        batch_of(
            [],
            seq,
            records=_records([step], set(), 0.0),
            clock=Told((seq % 7 + 1) / 1000).report(),
        )
        for seq, step in enumerate(walk)
    ]
    for batch in [*posted[10:], *posted[:10][::-1]]:
        await server.registry.submit(batch)
    assert server.log.reads < 3
    await server.run_idle()
    wanted = [_shifted(step, 0.001) for step in walk]
    assert server.track() == straight_track(wanted, ChainFold())


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


@pytest.mark.anyio
async def test_a_session_wakes_up_with_the_clock_that_counts() -> None:
    server = Server(SessionLimits(snapshot_every_s=1.0))
    walk = list(steps_at(*range(31)))
    posted = [
        batch_of([], seq, records=_records([step], set(), 0.0), clock=Told(seq / 1000).report())
        for seq, step in enumerate(walk)
    ]
    for batch in [*posted[1:30], posted[0]]:
        await server.registry.submit(batch)
    server.clock.time_s += server.limits.evict_s
    await server.registry.sweep()
    reply = await server.registry.submit(posted[30])
    state, fold = ChainFold().start(), ChainFold()
    for step in walk:
        state, _ = fold.advance(state, step, SITE, PARAMS)
    assert reply.output == fold.finish(state, SITE, PARAMS)[-1]
