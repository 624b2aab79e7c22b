"""Sessions and batches that the storage tests write."""

import math

import numpy as np

from app.core.session import LoggedBatch, SessionClock, SessionRecord
from app.core.types import (
    ImuBlock,
    Method,
    MotionMode,
    Observation,
    Reading,
    TrackPoint,
    Used,
    WifiScan,
)

CLOCK = SessionClock(
    True, ahead_s=-0.1, mono_ahead_s=0.1, mono_to_wall_s=1e9 / 3, mono_seq=2**40, boot_id="b"
)


def session_record(
    session_id: str = "s-1", device_id: str = "phone-1", opened_s: float = 100.0
) -> SessionRecord:
    return SessionRecord(
        session_id=session_id,
        device_id=device_id,
        session=f"run of {session_id}",
        site_id="site-1",
        profile="best",
        clock=CLOCK,
        opened_s=opened_s,
    )


def logged_batch(seq: int, *observations: Observation, session_id: str = "s-1") -> LoggedBatch:
    return LoggedBatch(
        session_id=session_id,
        seq=seq,
        digest=b"digest\x00",
        received_s=1e9 + 0.1,
        observations=observations,
    )


def wifi_scan(time_s: float) -> WifiScan:
    return WifiScan(time_s, (Reading(("mac:0123456789ab",), -61.5, 0.25),))


def imu_block(time_s: float, samples: int = 4) -> ImuBlock:
    values = np.linspace(-1.0, 1.0, samples * 4, dtype=np.float32).reshape(samples, 4)
    empty = np.empty((0, 3), np.float32)
    return ImuBlock(time_s, 50.0, values[:, :3], values[:, 1:], empty, values)


def track_point(time_s: float, x_m: float = 1.0, floor_id: str = "F1") -> TrackPoint:
    return TrackPoint(
        time_s=time_s,
        floor_id=floor_id,
        x_m=x_m,
        y_m=-0.0,
        covariance_m2=(1 / 3, -5e-324, 2 / 3),
        radius95_m=math.nextafter(3.0, 4.0),
        speed_mps=0.1 + 0.2,
        heading_rad=-math.pi,
        motion=MotionMode.WALKING,
        method=Method.FUSED,
        floor_confidence=1.0,
        used=Used(3, 20, 2),
        age_s=0.0,
        zones=("gate", "hall \N{SNOWMAN}"),
    )
