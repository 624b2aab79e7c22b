"""What a phone in a walker's hand reports: scans, steps or inertial blocks, with its own faults."""

from dataclasses import dataclass

import numpy as np

from app.core.simulate.radio import FADING_DB, Transmitters
from app.core.simulate.routes import WalkTruth
from app.core.types import (
    BleScan,
    BoolArray,
    FloatArray,
    ImuBlock,
    IntArray,
    Reading,
    Steps,
    WifiScan,
)

GRAVITY_MPS2 = 9.81
BLE_SCAN_S, ADVERTISING_S = 1.0, 0.5
WIFI_SCAN_S = (2.0, 4.0)
LOSS_PROBABILITY = 0.15
IMU_RATE_HZ = 50.0
# A phone held in the hand of a walker swings by 2 to 3 m/s2 up and down once per step.
SWING_MPS2 = 2.5


@dataclass(frozen=True, slots=True)
class Phone:
    """The faults of one phone and the gait of its carrier.

    Attributes
    ----------
    level_offset_db
        Added to every level that it reports.
    holding_rad, drift_radps
        What its heading is off by at the start of the walk, and how that grows.
    step_length_m, step_deviation_ratio
        Mean length of a step, and the relative deviation of single ones.
    miss_probability
        Share of steps that its detector misses.
    """

    level_offset_db: float
    holding_rad: float
    drift_radps: float
    step_length_m: float
    step_deviation_ratio: float = 0.05
    miss_probability: float = 0.03
    heading_noise_rad: float = 0.05


def draw_phone(rng: np.random.Generator) -> Phone:
    """Return a phone as people have them: +-4 dB, held some 10 degrees off, drifting slowly."""
    return Phone(
        level_offset_db=float(rng.uniform(-4.0, 4.0)),
        holding_rad=float(rng.normal(0.0, np.radians(10.0))),
        drift_radps=float(rng.normal(0.0, np.radians(0.02))),
        step_length_m=float(rng.normal(0.70, 0.05)),
    )


def ble_scans(
    phone: Phone, truth: WalkTruth, beacons: Transmitters, rng: np.random.Generator
) -> list[BleScan]:
    """Return one scan a second with every advertisement heard since the last one."""
    start_s, end_s = truth.time_s[0], truth.time_s[-1]
    per_scan = round(BLE_SCAN_S / ADVERTISING_S)
    scans = int((end_s - start_s) / BLE_SCAN_S)
    ages_s = (np.arange(per_scan)[::-1] + 0.5) * ADVERTISING_S
    scan_s = _whole_ms(start_s + (np.arange(scans) + 1) * BLE_SCAN_S)
    points = truth.points_at((scan_s[:, None] - ages_s).ravel())
    heard, rssi_dbm = _hear(phone, beacons, points, rng)
    keys = [anchor.keys for anchor in beacons.anchors]
    result: list[BleScan] = []
    for i, time_s in enumerate(scan_s):
        readings = tuple(
            Reading(keys[t], float(rssi_dbm[row, t]), float(age_s))
            for row, age_s in zip(range(i * per_scan, (i + 1) * per_scan), ages_s, strict=True)
            for t in np.flatnonzero(heard[row])
        )
        result.append(BleScan(float(time_s), readings))
    return result


def wifi_scans(
    phone: Phone, truth: WalkTruth, access_points: Transmitters, rng: np.random.Generator
) -> list[WifiScan]:
    """Return a scan every two to four seconds; its levels are up to a second old."""
    count = int((truth.time_s[-1] - truth.time_s[0]) / WIFI_SCAN_S[0])
    scan_s = _whole_ms(truth.time_s[0] + np.cumsum(rng.uniform(*WIFI_SCAN_S, count)))
    scan_s = scan_s[scan_s <= truth.time_s[-1]]
    ages_s = _whole_ms(rng.uniform(0.0, 1.0, len(scan_s)))
    heard, rssi_dbm = _hear(phone, access_points, truth.points_at(scan_s - ages_s), rng)
    keys = [anchor.keys for anchor in access_points.anchors]
    return [
        WifiScan(
            float(time_s),
            tuple(
                Reading(keys[t], float(rssi_dbm[i, t]), float(ages_s[i]))
                for t in np.flatnonzero(heard[i])
            ),
        )
        for i, time_s in enumerate(scan_s)
    ]


def steps(phone: Phone, truth: WalkTruth, rng: np.random.Generator) -> list[Steps]:
    """Return one event per step that the phone's detector noticed, with the heading it believes."""
    borders_m = _step_borders_m(phone, truth, rng)
    # Standing still adds no distance; the tiny slope makes the inverse unique.
    walked_m = truth.walked_m + 1e-9 * np.arange(len(truth.walked_m))
    time_s = np.interp(borders_m, walked_m, truth.time_s)
    places = truth.points_at(time_s)
    stride = np.diff(places[:, :2], axis=0)
    heading_rad = np.arctan2(stride[:, 1], stride[:, 0])
    heading_rad += _heading_error_rad(phone, truth, time_s[1:])
    heading_rad += rng.normal(0.0, phone.heading_noise_rad, len(heading_rad))
    noticed = rng.random(len(heading_rad)) >= phone.miss_probability
    events = zip(_whole_ms(time_s[1:])[noticed], _wrap(heading_rad)[noticed], strict=True)
    return [Steps(float(t), 1, heading_rad=float(h)) for t, h in events]


def imu_blocks(phone: Phone, truth: WalkTruth, rng: np.random.Generator) -> list[ImuBlock]:
    """Return the walk as one-second blocks of a phone held flat, its top pointing forward.

    The specific force is gravity plus one swing per step, upward and (a quarter of a step later)
    forward; the rotation vector carries the same error as the heading of the steps.
    """
    blocks = int(truth.time_s[-1] - truth.time_s[0])
    per_block = round(IMU_RATE_HZ)
    time_s = truth.time_s[0] + np.arange(blocks * per_block) / IMU_RATE_HZ
    borders_m = _step_borders_m(phone, truth, rng)
    walked_m = np.interp(time_s, truth.time_s, truth.walked_m)
    phase_rad = 2.0 * np.pi * np.interp(walked_m, borders_m, np.arange(len(borders_m)))
    walking = np.gradient(walked_m, time_s) > 0.2
    acc = rng.normal(0.0, 0.15, (len(time_s), 3))
    acc[:, 1] += walking * 0.4 * SWING_MPS2 * np.sin(phase_rad)
    acc[:, 2] += GRAVITY_MPS2 + walking * SWING_MPS2 * np.cos(phase_rad)
    turn_rad = _turned_rad(truth, time_s) + _heading_error_rad(phone, truth, time_s)
    gyro = rng.normal(0.0, 0.01, (len(time_s), 3))
    gyro[:, 2] += np.gradient(turn_rad, time_s)
    # The phone's y axis points along the heading; at angle pi / 2 it would point north.
    half_rad = (turn_rad - np.pi / 2.0) / 2.0
    quat = np.zeros((len(time_s), 4))
    quat[:, 0], quat[:, 3] = np.cos(half_rad), np.sin(half_rad)
    begin_s = _whole_ms(time_s[::per_block])
    acc32, gyro32, quat32 = (a.astype(np.float32) for a in (acc, gyro, quat))
    no_field = np.empty((0, 3), dtype=np.float32)
    cuts = [slice(i * per_block, (i + 1) * per_block) for i in range(blocks)]
    return [
        ImuBlock(float(t), IMU_RATE_HZ, acc32[c], gyro32[c], no_field, quat32[c])
        for t, c in zip(begin_s, cuts, strict=True)
    ]


def _hear(
    phone: Phone, radio: Transmitters, points: FloatArray, rng: np.random.Generator
) -> tuple[BoolArray, IntArray]:
    """Return which transmitters are heard at each point, and the whole dBm that the phone tells."""
    level_dbm = radio.mean_levels_dbm(points) + rng.normal(
        0.0, FADING_DB, (len(points), len(radio.anchors))
    )
    received = rng.random(level_dbm.shape) >= LOSS_PROBABILITY
    heard: BoolArray = received & (level_dbm >= radio.detection_dbm)
    rssi_dbm = np.clip(np.rint(level_dbm + phone.level_offset_db), -120, -20)
    return heard, rssi_dbm.astype(np.int64)


def _step_borders_m(phone: Phone, truth: WalkTruth, rng: np.random.Generator) -> FloatArray:
    """Return the distances walked at which steps end, the first border being the start."""
    walked_m = float(truth.walked_m[-1])
    most = int(walked_m / (phone.step_length_m * (1.0 - 4.0 * phone.step_deviation_ratio))) + 1
    lengths_m = phone.step_length_m * (
        1.0 + phone.step_deviation_ratio * rng.normal(size=most).clip(-3, 3)
    )
    borders_m = np.concatenate(([0.0], np.cumsum(lengths_m)))
    return borders_m[borders_m <= walked_m]


def _heading_error_rad(phone: Phone, truth: WalkTruth, time_s: FloatArray) -> FloatArray:
    elapsed_s: FloatArray = time_s - truth.time_s[0]
    return phone.holding_rad + phone.drift_radps * elapsed_s


def _turned_rad(truth: WalkTruth, time_s: FloatArray) -> FloatArray:
    """Return the continuous walking direction; a turn takes about half a second, a rest none."""
    vx, vy = np.gradient(truth.x_m), np.gradient(truth.y_m)
    moving = np.flatnonzero(np.hypot(vx, vy) > 0.01)
    if len(moving) == 0:
        return np.zeros(len(time_s))
    direction_rad = np.unwrap(np.arctan2(vy[moving], vx[moving]))
    held_rad = np.interp(np.arange(len(vx)), moving, direction_rad)
    smooth_rad = np.convolve(np.pad(held_rad, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    turned_rad: FloatArray = np.interp(time_s, truth.time_s, smooth_rad)
    return turned_rad


def _wrap(angle_rad: FloatArray) -> FloatArray:
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def _whole_ms(time_s: FloatArray) -> FloatArray:
    """Return times as a phone tells them: in whole milliseconds."""
    return np.rint(time_s * 1000.0) / 1000.0
