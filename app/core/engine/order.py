"""The one order in which a session's observations are folded, however they arrived."""

import hashlib
from array import array
from collections.abc import Iterable
from typing import TypeAlias

from app.core.types import (
    Barometer,
    BleScan,
    ImuBlock,
    Observation,
    Pedometer,
    Steps,
    Truth,
    WifiScan,
)

OrderKey: TypeAlias = tuple[float, int, bytes]

# At equal times motion comes before scans: a scan then meets the prediction it belongs to.
_RANK: dict[type, int] = {
    Truth: 0,
    Barometer: 1,
    ImuBlock: 2,
    Pedometer: 3,
    Steps: 4,
    BleScan: 5,
    WifiScan: 6,
}


def order_key(observation: Observation) -> OrderKey:
    """Return the sort key: event time, then kind, then a digest of the content.

    Equal keys mean equal observations: the fold takes such a pair once.
    """
    return (observation.time_s, _RANK[type(observation)], _digest(observation))


def in_order(observations: Iterable[Observation]) -> list[Observation]:
    """Return observations as they are folded: in order, each once."""
    by_key = {order_key(observation): observation for observation in observations}
    return [by_key[key] for key in sorted(by_key)]


def _digest(observation: Observation) -> bytes:
    digest = hashlib.blake2b(digest_size=8)
    if isinstance(observation, ImuBlock):
        digest.update(repr(observation.rate_hz).encode())
        for samples in (
            observation.acc_mps2,
            observation.gyro_radps,
            observation.mag_ut,
            observation.quat_wxyz,
        ):
            digest.update(samples.tobytes())
    elif isinstance(observation, WifiScan | BleScan):
        readings = observation.readings
        levels = array("d", [value for r in readings for value in (r.rssi_dbm, r.age_s)])
        digest.update("\n".join("\t".join(r.keys) for r in readings).encode())
        digest.update(levels.tobytes())
    else:
        digest.update(repr(observation).encode())
    return digest.digest()
