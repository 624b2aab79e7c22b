"""From the phone's clocks to event time."""

import numpy as np
import pytest
from session_ports import START_S, batch_of

from app.core.session import SessionClock
from app.core.types import ImuBlock, Pedometer, Steps
from app.sessions.batch import ClockReport, IncomingRecord
from app.sessions.clock import freeze_clock, is_same_clock, observations_in_event_time

HOUR_S = 3600.0


@pytest.mark.parametrize(
    ("report", "clock"),
    [
        (ClockReport(sent_s=START_S - 1.5), SessionClock()),
        (ClockReport(sent_s=START_S - 60), SessionClock(offset_s=60.0)),
        (ClockReport(sent_s=START_S + 60), SessionClock(offset_s=-60.0)),
        (ClockReport(), SessionClock()),
        (ClockReport(recorded=True, sent_s=START_S - 60), SessionClock(recorded=True)),
        (
            ClockReport(sent_s=START_S - 60, mono_s=500.0, boot_id="b"),
            SessionClock(offset_s=60.0, mono_to_wall_s=START_S - 560, boot_id="b"),
        ),
        (ClockReport(mono_s=500.0), SessionClock()),
        (
            ClockReport(recorded=True, sent_s=1000.0, mono_s=400.0),
            SessionClock(recorded=True, mono_to_wall_s=600.0),
        ),
    ],
)
def test_the_first_batch_freezes_the_clock(report: ClockReport, clock: SessionClock) -> None:
    assert freeze_clock(report, received_s=START_S) == clock


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
    clock = SessionClock(offset_s=60.0, mono_to_wall_s=START_S - 560)
    records = (
        IncomingRecord(0, Steps(START_S - 61, 1)),
        IncomingRecord(1, Steps(499.0, 2), monotonic=True),
        IncomingRecord(2, Pedometer(490.0, 498.0, 9), monotonic=True),
    )
    observations, rejected = observations_in_event_time(batch_of([], records=records), clock)
    assert rejected == ()
    assert observations == (
        Steps(START_S - 1, 1),
        Steps(START_S - 1, 2),
        Pedometer(START_S - 10, START_S - 2, 9),
    )


def test_event_time_is_the_same_to_the_bit_whichever_batch_froze_the_clock() -> None:
    booted_ms, heard_ms = 1_763_769_476_544, 98_765
    for sent_ms in range(100_000, 130_000, 1_037):
        report = ClockReport(sent_s=(booted_ms + sent_ms) / 1000.0, mono_s=sent_ms / 1000.0)
        batch = batch_of([], records=(IncomingRecord(0, Steps(heard_ms / 1000.0, 1), True),))
        clock = freeze_clock(report, received_s=(booted_ms + sent_ms) / 1000.0)
        (steps,), _ = observations_in_event_time(batch, clock)
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
        (IncomingRecord(3, Steps(400.0, 1), monotonic=True), "no_clock"),
    ],
)
def test_a_live_record_out_of_its_time_is_rejected_alone(record: IncomingRecord, code: str) -> None:
    good = IncomingRecord(4, Steps(START_S, 1))
    batch = batch_of([], records=(good, record))
    observations, rejected = observations_in_event_time(batch, SessionClock())
    assert observations == (good.observation,)
    assert [(r.index, r.code) for r in rejected] == [(3, code)]


def test_rejections_come_in_the_order_of_the_records() -> None:
    from app.core.session import Rejection

    edge = Rejection(9, "rssi_range")
    records = (IncomingRecord(2, Steps(0.0, 1)),)
    batch = batch_of([], records=records, rejected=(edge,))
    _, rejected = observations_in_event_time(batch, SessionClock())
    assert [r.index for r in rejected] == [2, 9]


def test_the_age_is_judged_after_the_correction() -> None:
    clock = freeze_clock(ClockReport(sent_s=START_S - 48 * HOUR_S), START_S)
    batch = batch_of([], records=(IncomingRecord(0, Steps(START_S - 48 * HOUR_S, 1)),))
    observations, rejected = observations_in_event_time(batch, clock)
    assert (observations, rejected) == ((Steps(START_S, 1),), ())


def test_a_recording_has_no_age_limits() -> None:
    old, coming = Steps(1000.0, 1), Steps(START_S + 1e6, 1)
    observations, rejected = observations_in_event_time(
        batch_of([old, coming]), SessionClock(recorded=True)
    )
    assert (observations, rejected) == ((old, coming), ())
