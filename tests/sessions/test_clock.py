"""From the phone's clocks to event time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from session_ports import START_S, batch_of

from app.core.session import Rejection, SessionClock, event_times
from app.core.types import ImuBlock, Observation, Pedometer, Steps
from app.sessions.batch import ClockReport, IncomingBatch, IncomingRecord
from app.sessions.clock import is_same_clock, logged_batch, settled_clock

HOUR_S = 3600.0


def _timed(
    batch: IncomingBatch, clock: SessionClock
) -> tuple[tuple[Observation, ...], tuple[Rejection, ...]]:
    logged = logged_batch(batch, "s", clock, START_S)
    return tuple(event_times([logged], clock)), logged.rejected


def _settled(
    *told: tuple[int, ClockReport], received_s: float = START_S, opened_s: float = START_S
) -> SessionClock:
    """Return the clock that batches (seq, report) tell together, in their order of arrival."""
    clock = SessionClock(told[0][1].recorded)
    for seq, report in told:
        batch = batch_of([], seq, clock=report, received_s=received_s)
        clock = settled_clock(clock, batch, opened_s)
    return clock


@pytest.mark.parametrize(
    ("report", "offset_s", "mono_to_wall_s"),
    [
        (ClockReport(sent_s=START_S - 1.5), 0.0, None),
        (ClockReport(sent_s=START_S - 60), 60.0, None),
        (ClockReport(sent_s=START_S + 60), -60.0, None),
        (ClockReport(), 0.0, None),
        (ClockReport(recorded=True, sent_s=START_S - 60), 0.0, None),
        (ClockReport(sent_s=START_S - 60, mono_s=500.0, boot_id="b"), 60.0, START_S - 560),
        (ClockReport(sent_s=START_S - 1, mono_s=500.0), 0.0, START_S - 501),
        (ClockReport(mono_s=500.0), 0.0, None),
        (ClockReport(recorded=True, sent_s=1000.0, mono_s=400.0), 0.0, 600.0),
    ],
)
def test_a_batch_tells_the_clocks(
    report: ClockReport, offset_s: float, mono_to_wall_s: float | None
) -> None:
    clock = _settled((0, report))
    assert (clock.offset_s, clock.mono_to_wall_s) == (offset_s, mono_to_wall_s)
    assert (clock.recorded, clock.boot_id) == (report.recorded, report.boot_id)


REPORTS = st.builds(
    ClockReport,
    sent_s=st.none() | st.floats(START_S - 90, START_S + 90),
    mono_s=st.none() | st.floats(400, 600),
    boot_id=st.sampled_from([None, "b"]),
)


@given(st.lists(REPORTS, min_size=1, max_size=6), st.data())
def test_the_clock_is_the_same_whatever_batch_came_first(
    reports: list[ClockReport], data: st.DataObject
) -> None:
    told = list(enumerate(reports))
    arrived = data.draw(st.permutations(told + told[:2]))
    assert _settled(*arrived) == _settled(*told)


def test_the_lowest_seq_tells_the_monotonic_clock() -> None:
    sent = [ClockReport(sent_s=START_S + jitter_s, mono_s=50.0) for jitter_s in (0.0, 0.004, 0.02)]
    clock = _settled((7, sent[0]), (3, sent[1]), (9, sent[2]))
    assert (clock.mono_to_wall_s, clock.mono_seq) == (START_S + 0.004 - 50.0, 3)
    again = _settled((3, sent[1]), (3, sent[2]))
    assert again.mono_to_wall_s == START_S + 0.004 - 50.0, "a retry is no other batch"


def test_a_message_that_was_long_under_way_does_not_shift_the_session() -> None:
    stuck = ClockReport(sent_s=START_S - 40, mono_s=10.0)
    prompt = ClockReport(sent_s=START_S - 0.1, mono_s=49.9)
    clock = _settled((0, stuck), (1, prompt))
    assert (clock.offset_s, clock.mono_to_wall_s) == (0.0, START_S - 50)


def test_a_wall_clock_that_is_set_right_meanwhile_moves_no_monotonic_time() -> None:
    wrong = ClockReport(sent_s=START_S - 100, mono_s=50.0)
    right = ClockReport(sent_s=START_S, mono_s=50.0)
    clock = _settled((0, wrong), (1, right))
    assert clock.offset_s + clock.mono_to_wall_s == START_S - 50


def test_only_the_first_minute_tells_how_far_the_wall_clock_is_off() -> None:
    first = _settled((0, ClockReport(sent_s=START_S - 60)))
    later = batch_of([], 1, clock=ClockReport(sent_s=START_S + 61), received_s=START_S + 61)
    assert settled_clock(first, later, START_S) == first


@pytest.mark.parametrize(
    ("report", "same"),
    [
        (ClockReport(boot_id="first"), True),
        (ClockReport(), True),
        (ClockReport(boot_id="second"), False),
        (ClockReport(boot_id="first", recorded=True), False),
    ],
)
def test_a_clock_changes_with_its_boot_or_mode(report: ClockReport, same: bool) -> None:
    assert is_same_clock(SessionClock(boot_id="first"), report) is same


def test_wall_and_monotonic_times_are_shifted_to_event_time() -> None:
    clock = SessionClock(ahead_s=60.0, mono_to_wall_s=START_S - 560)
    records = (
        IncomingRecord(0, Steps(START_S - 61, 1)),
        IncomingRecord(1, Steps(499.0, 2), monotonic=True),
        IncomingRecord(2, Pedometer(490.0, 498.0, 9), monotonic=True),
    )
    observations, rejected = _timed(batch_of([], records=records), clock)
    assert rejected == ()
    assert observations == (
        Steps(START_S - 1, 1),
        Steps(START_S - 1, 2),
        Pedometer(START_S - 10, START_S - 2, 9),
    )


def test_event_time_is_the_same_to_the_bit_whichever_batch_told_the_clock() -> None:
    booted_ms, heard_ms = 1_763_769_476_544, 98_765
    for sent_ms in range(100_000, 130_000, 1_037):
        report = ClockReport(sent_s=(booted_ms + sent_ms) / 1000.0, mono_s=sent_ms / 1000.0)
        batch = batch_of([], records=(IncomingRecord(0, Steps(heard_ms / 1000.0, 1), True),))
        sent_s = (booted_ms + sent_ms) / 1000.0
        clock = _settled((0, report), received_s=sent_s, opened_s=sent_s)
        (steps,), _ = _timed(batch, clock)
        assert steps.time_s == (booted_ms + heard_ms) / 1000.0


def _block(time_s: float, seconds: int) -> ImuBlock:
    none = np.empty((0, 3), dtype=np.float32)
    acc_mps2 = np.zeros((seconds * 10 + 1, 3), dtype=np.float32)
    return ImuBlock(time_s, 10.0, acc_mps2, none, none, np.empty((0, 4), dtype=np.float32))


@pytest.mark.parametrize(
    ("record", "code"),
    [
        (IncomingRecord(3, Steps(START_S - 24 * HOUR_S - 1, 1)), "too_old"),
        (IncomingRecord(3, Steps(START_S + 301, 1)), "in_future"),
        (IncomingRecord(3, _block(START_S + 299, seconds=2)), "in_future"),
    ],
)
def test_a_live_record_out_of_its_time_is_rejected_alone(record: IncomingRecord, code: str) -> None:
    good = IncomingRecord(4, Steps(START_S, 1))
    batch = batch_of([], records=(good, record))
    observations, rejected = _timed(batch, SessionClock())
    assert observations == (good.observation,)
    assert [(r.index, r.code) for r in rejected] == [(3, code)]


def test_a_record_waits_a_minute_for_its_clock() -> None:
    records = (IncomingRecord(0, Steps(400.0, 1), monotonic=True), IncomingRecord(1, Steps(1.0, 1)))
    clock = SessionClock(recorded=True)
    for after_s, taken in ((60.0, 2), (60.1, 1)):
        batch = batch_of([], records=records, received_s=START_S + after_s)
        logged = logged_batch(batch, "s", clock, START_S)
        assert len(logged.observations) == taken
        assert [(r.index, r.code) for r in logged.rejected] == [(0, "no_clock")][: 2 - taken]
        assert list(event_times([logged], clock)) == [Steps(1.0, 1)]


def test_rejections_come_in_the_order_of_the_records() -> None:
    edge = Rejection(9, "rssi_range")
    records = (IncomingRecord(2, Steps(0.0, 1)),)
    batch = batch_of([], records=records, rejected=(edge,))
    _, rejected = _timed(batch, SessionClock())
    assert [r.index for r in rejected] == [2, 9]


def test_the_age_is_judged_after_the_correction() -> None:
    clock = _settled((0, ClockReport(sent_s=START_S - 48 * HOUR_S)))
    batch = batch_of([], records=(IncomingRecord(0, Steps(START_S - 48 * HOUR_S, 1)),))
    observations, rejected = _timed(batch, clock)
    assert (observations, rejected) == ((Steps(START_S, 1),), ())


def test_a_recording_has_no_age_limits() -> None:
    old, coming = Steps(1000.0, 1), Steps(START_S + 1e6, 1)
    observations, rejected = _timed(batch_of([old, coming]), SessionClock(recorded=True))
    assert (observations, rejected) == ((old, coming), ())
