"""One live session: folds what the log holds, in event-time order, and stores the points."""

import asyncio
import math
from collections.abc import Callable, Iterable
from dataclasses import replace

from app.core.engine import Explanation, SessionState, order_key
from app.core.params import Params
from app.core.session import LoggedBatch, SessionClock, SessionRecord, event_times
from app.core.site import SiteModel
from app.core.types import Output, TrackPoint
from app.sessions.limits import SessionLimits
from app.sessions.ports import SessionPorts
from app.sessions.window import Keyed, ReorderWindow, in_order, merge

# Event times count from the Unix epoch: nothing is older.
BEGINNING_S = 0.0

# The site as it is now and the parameters of the session's profile.
World = Callable[[SessionRecord], tuple[SiteModel, Params]]


class DeviceSession:
    """The fold of one session; its device's mailbox calls it, one thing at a time.

    ``provisional`` says that the stored track may lack something that the log holds: observations
    that came too late for the window, batches whose write was given up but may have landed, a clock
    that was settled after much was folded by another, or anything of that kind before a restart.
    `settle` then folds the entire log again.
    """

    def __init__(
        self, record: SessionRecord, world: World, ports: SessionPorts, limits: SessionLimits
    ) -> None:
        self.record = record
        self._world = world
        self._ports = ports
        self._limits = limits
        self._window = self._new_window(ports.fold.start())
        self._saved_s = -math.inf
        self._unconfirmed: set[int] = set()
        self._doubtful = False
        # By which the window was folded; the record's is the one that counts.
        self._clock = record.clock
        # The log may hold observations by a monotonic clock that nobody has told yet.
        self._waiting = False

    async def recover(self, *, provisional: bool) -> None:
        """Come back from the snapshot and the log after it."""
        record = self.record
        state = await self._ports.snapshots.load(record.session_id, record.profile)
        state = self._ports.fold.start() if state is None else state
        since_s = None if state.last_key is None else state.last_key[0]
        batches = await self._ports.log.read(record.session_id, since_s)
        self._window = self._new_window(state)
        self._saved_s = _time_s(state)
        self._doubtful = provisional
        self._waiting = record.clock.mono_to_wall_s is None
        todo, _ = self._window.sift(await self._sort_all(batches, record.clock))
        outputs = await self._fold_all(record, self._window, todo)
        self._replace_outputs(outputs)

    async def switch(self, record: SessionRecord) -> None:
        """Take on another profile: everything logged is folded again, as if it had always been on.

        What was told before ``record.profile_since_s`` stays in the track until the session ends.
        """
        window = self._new_window(self._ports.fold.start())
        batches = await self._ports.log.read(record.session_id)
        await self._fold_all(record, window, await self._sort_all(batches, record.clock))
        self.record, self._window, self._saved_s = record, window, -math.inf
        self._clock = record.clock

    async def settle_clock(self, record: SessionRecord) -> bool:
        """Take on another clock; tell whether the state has changed.

        While the window reaches back to the session's beginning, or if something waits for the
        clock, all is folded again with it; later on, not before the session is settled.
        """
        self.record = record
        if record.clock.keeps_times_of(self._clock):
            return False
        self._doubtful, self._saved_s = True, -math.inf
        if self._waiting or self._window.checkpoint.last_key is None:
            await self.settle()
            return True
        if self._clock.mono_to_wall_s is None:
            self._clock = replace(self._clock, mono_to_wall_s=record.clock.mono_to_wall_s)
        return False

    @property
    def folded_until_s(self) -> float | None:
        """Event time of the newest observation folded; whole seconds before it have been told."""
        state = self._window.state
        return None if state.last_key is None else state.last_key[0]

    @property
    def provisional(self) -> bool:
        """Whether the stored track may lack something that was logged."""
        return self._doubtful or bool(self._unconfirmed)

    @property
    def snapshot_due(self) -> bool:
        """Whether the last snapshot is older, in event time, than a restart should have to fold."""
        age_s = _time_s(self._window.checkpoint) - self._saved_s
        return age_s >= self._limits.snapshot_every_s

    def output(self) -> Output | None:
        """Return the position or its absence at the latest observation."""
        outputs = self._ports.fold.finish(self._window.state, *self._world(self.record))
        return outputs[-1] if outputs else None

    def explained(self) -> Explanation | None:
        """Return why `output` is what it is."""
        return self._ports.fold.explained(self._window.state, *self._world(self.record))

    def pending_points(self) -> tuple[TrackPoint, ...]:
        """Return the points that the stored track would end with if nothing more came."""
        return _points(self._ports.fold.finish(self._window.state, *self._world(self.record)))

    def mark_unconfirmed(self, seq: int) -> None:
        """Remember a batch whose write was given up: it may yet have landed in the log."""
        self._unconfirmed.add(seq)

    def is_unconfirmed(self, seq: int) -> bool:
        """Tell whether a batch of the log may never have been folded."""
        return seq in self._unconfirmed

    async def take(self, batch: LoggedBatch) -> bool:
        """Fold a logged batch; tell whether the state has changed."""
        fresh, late = self._window.sift(await self._sort_all([batch], self._clock))
        if batch.monotonic_count and self._clock.mono_to_wall_s is None:
            self._waiting = True
        self._doubtful = self._doubtful or late
        self._unconfirmed.discard(batch.seq)
        if not fresh:
            return False
        undone = self._window.rewind(fresh[0].key)
        outputs = await self._fold_all(self.record, self._window, merge(fresh, undone))
        if undone:
            self._replace_outputs(outputs)
        elif points := _points(outputs):
            self._ports.tracks.write(self.record.session_id, points)
        return True

    async def settle(self) -> None:
        """Make the stored track the exact track of everything logged."""
        if not self.provisional:
            return
        batches = await self._ports.log.read(self.record.session_id)
        window, clock = self._new_window(self._ports.fold.start()), self.record.clock
        outputs = await self._fold_all(self.record, window, await self._sort_all(batches, clock))
        self._window, self._clock = window, clock
        self._doubtful = False
        self._waiting = self._waiting and clock.mono_to_wall_s is None
        self._replace_from(BEGINNING_S, outputs)

    async def finish(self) -> None:
        """Store the final track, smoothed over everything logged, and mark it as final."""
        batches = await self._ports.log.read(self.record.session_id)
        keyed = await self._sort_all(batches, self.record.clock)
        observations = [k.observation for k in keyed]
        # A whole day may take seconds: in a thread, other phones are served meanwhile.
        world = self._world(self.record)
        points = await asyncio.to_thread(self._ports.fold.smoothed, observations, *world)
        # Should the phone come back, its track is provisional again.
        self._doubtful = True
        self._ports.tracks.replace_from(self.record.session_id, BEGINNING_S, points)
        await self._ports.tracks.flush()
        await self._ports.log.finish_session(self.record.session_id)

    async def snapshot(self) -> None:
        """Save the checkpoint; the points up to it are with the track store already.

        Of a window that was folded by another clock than the session's there is none to save.
        """
        checkpoint, record = self._window.checkpoint, self.record
        if checkpoint.last_key is not None and record.clock.keeps_times_of(self._clock):
            await self._ports.snapshots.save(record.session_id, record.profile, checkpoint)
            self._saved_s = _time_s(checkpoint)

    def _replace_outputs(self, outputs: list[Output]) -> None:
        # The first output after a state is of the same second, whatever is folded next: these
        # stand for all that was ever put out after the state they were folded from.
        if outputs:
            self._replace_from(outputs[0].time_s, outputs)

    def _replace_from(self, from_s: float, outputs: list[Output]) -> None:
        since_s = self.record.profile_since_s
        if since_s is not None:
            from_s = max(from_s, since_s)
        points = [point for point in _points(outputs) if point.time_s >= from_s]
        self._ports.tracks.replace_from(self.record.session_id, from_s, points)

    async def _sort_all(self, batches: Iterable[LoggedBatch], clock: SessionClock) -> list[Keyed]:
        """Return the batches' observations in order, each once."""
        arrived: list[Keyed] = []
        for done, observation in enumerate(event_times(batches, clock), start=1):
            arrived.append(Keyed(order_key(observation), observation))
            await self._give_way(done)
        return in_order(arrived)

    async def _fold_all(
        self, record: SessionRecord, window: ReorderWindow, todo: list[Keyed]
    ) -> list[Output]:
        site, params = self._world(record)
        outputs: list[Output] = []
        for done, keyed in enumerate(todo, start=1):
            outputs.extend(window.push(keyed, site, params))
            await self._give_way(done)
        return outputs

    async def _give_way(self, done: int) -> None:
        if done % self._limits.fold_chunk == 0:
            await asyncio.sleep(0)

    def _new_window(self, state: SessionState) -> ReorderWindow:
        return ReorderWindow(self._ports.fold, state, self._limits.reorder_window_s)


def _points(outputs: Iterable[Output]) -> tuple[TrackPoint, ...]:
    return tuple(output for output in outputs if isinstance(output, TrackPoint))


def _time_s(state: SessionState) -> float:
    return -math.inf if state.last_key is None else state.last_key[0]
