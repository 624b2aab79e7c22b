"""Simulated phones that post what they hear and count as real ones would: over HTTP, as it happens.

Each phone keeps one session, posts about a second of observations at a time, gzipped and numbered,
and holds on to a batch until the server has acknowledged it.
"""

import asyncio
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field

from app.cli.errors import CommandError
from app.cli.phone_client import PhoneClient
from app.core.simulate import SimulatedWalk, Warehouse, walk
from app.core.types import Observation
from app.formats.ingest_body import ingest_body
from app.sessions.ports import Clock

DEVICE_PREFIX = "picker-"
BATCH_S = 1.0
# Walks are made in pieces, so that a phone never waits long for the next one to be computed.
WALK_S = 180.0
CONNECTIONS = 8


@dataclass(slots=True)
class Tally:
    """What was acknowledged so far, and how many of the replies held a fix."""

    batches: int = 0
    fixes: int = 0


@dataclass(slots=True)
class Fleet:
    """The phones of a demo.

    Attributes
    ----------
    speed
        Event seconds per real second. Other than 1, the phones say that they play recordings.
    stopping
        Phones walk no further: a cancellation alone may be lost in the midst of a request.
    """

    url: str
    token: str
    world: Warehouse
    clock: Clock
    phones: int = 30
    speed: float = 1.0
    tally: Tally = field(default_factory=Tally)
    stopping: bool = False

    async def run(self) -> None:
        """Let all phones walk until cancelled; CommandError if the server refuses them."""
        async with PhoneClient(self.url, self.token, CONNECTIONS) as client:
            phones = [_Phone(self, client, number) for number in range(self.phones)]
            try:
                async with asyncio.TaskGroup() as group:
                    for phone in phones:
                        group.create_task(phone.walk())
            except* CommandError as refusals:
                # All phones are refused for the same reason; one of them tells it.
                raise refusals.exceptions[0] from None


class _Phone:
    """One phone: its session, its walk, its unacknowledged batch."""

    def __init__(self, fleet: Fleet, client: PhoneClient, number: int) -> None:
        self._fleet = fleet
        self._client = client
        self._number = number
        # Spread over the second, or all would post at once.
        self._begin_s = fleet.clock.now_s() + BATCH_S * number / max(fleet.phones, 1)
        self._device = {
            "id": device_id_of(number),
            "platform": "android",
            "model": "Simulated",
        }
        self._session = str(uuid.uuid4())
        self._seq = 0

    async def walk(self) -> None:
        """Walk on and on, posting each batch when its time has come."""
        piece: SimulatedWalk | None = None
        start_s = self._begin_s
        while True:
            # Unequal first pieces keep the phones from computing the next ones all at once.
            duration_s = WALK_S if piece else WALK_S / 3.0 + 7.0 * (self._number % 15)
            piece = await asyncio.to_thread(
                walk, self._fleet.world, self._number, start_s, duration_s, after=piece
            )
            for due_s, observations in batches(piece, start_s):
                await self._sleep_until(due_s)
                if self._fleet.stopping:
                    return
                await self._post(observations)
            start_s += duration_s

    async def _sleep_until(self, event_s: float) -> None:
        due_s = self._begin_s + (event_s - self._begin_s) / self._fleet.speed
        await asyncio.sleep(max(0.0, due_s - self._fleet.clock.now_s()))

    async def _post(self, observations: list[Observation]) -> None:
        """Post one batch until it is acknowledged."""
        reply = await self._client.post_batch(ingest_body(self._header(), self._seq, observations))
        self._seq += 1
        self._fleet.tally.batches += 1
        self._fleet.tally.fixes += reply["fix"] is not None

    def _header(self) -> dict[str, object]:
        recorded = {} if self._fleet.speed == 1.0 else {"mode": "recorded"}
        return {
            "device": self._device,
            "session": self._session,
            "site": self._fleet.world.site.site_id,
            "clock": {"sent_ms": self._fleet.clock.now_s() * 1000.0, **recorded},
        }


def device_id_of(number: int) -> str:
    """Return the name of a phone for itself."""
    return f"{DEVICE_PREFIX}{number + 1:03d}"


def people_of(phones: int) -> dict[str, str]:
    """Return who carries which phone: a name by the phone's id."""
    return {device_id_of(number): f"Picker {number + 1:03d}" for number in range(phones)}


def batches(piece: SimulatedWalk, start_s: float) -> Iterator[tuple[float, list[Observation]]]:
    """Yield a walk's observations second by second, with the time at which each second is over."""
    batch: list[Observation] = []
    due_s = start_s + BATCH_S
    for observation in piece.observations:
        while observation.time_s > due_s:
            if batch:
                yield due_s, batch
            batch, due_s = [], due_s + BATCH_S
        batch.append(observation)
    if batch:
        yield due_s, batch
