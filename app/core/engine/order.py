"""The one order in which a session's observations are folded, however they arrived."""

import hashlib
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from operator import itemgetter
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


@dataclass(frozen=True, eq=False)
class Content:
    """What an observation says, compared by its digest.

    Few observations share time and kind, and a digest takes longer than many of them do to fold:
    that of an observation is made when it is first asked for.
    """

    digest: bytes

    @classmethod
    def of(cls, observation: Observation) -> "Content":
        """Return the content of an observation."""
        content = cls.__new__(cls)
        vars(content)["observation"] = observation
        return content

    def __getattr__(self, name: str) -> bytes:
        # Asked for what is not there yet.
        if name != "digest" or "observation" not in vars(self):
            raise AttributeError(name)
        digest = vars(self)["digest"] = _digest(vars(self)["observation"])
        return digest

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Content):
            return NotImplemented
        mine, its = vars(self).get("observation"), vars(other).get("observation")
        return (mine is its and mine is not None) or self.digest == other.digest

    def __lt__(self, other: "Content") -> bool:
        return self.digest < other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


OrderKey: TypeAlias = tuple[float, int, Content]

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
    """Return the sort key: event time, then kind, then content.

    Equal keys mean equal observations: the fold takes such a pair once.
    """
    return (observation.time_s, _RANK[type(observation)], Content.of(observation))


def in_order(observations: Iterable[Observation]) -> list[Observation]:
    """Return observations as they are folded: in order, each once."""
    arrived = sorted(((order_key(one), one) for one in observations), key=itemgetter(0))
    keys = [None, *(key for key, _ in arrived)]
    return [one for (key, one), last in zip(arrived, keys, strict=False) if key != last]


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
