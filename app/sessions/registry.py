"""The registry: finds, starts, recovers and ends live sessions; the way in for every batch."""

import asyncio
import logging
import math
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from app.core.engine import Explanation
from app.core.params import Params
from app.core.session import (
    LoggedBatch,
    LogUnavailableError,
    SessionClock,
    SessionRecord,
    each_in_event_time,
)
from app.core.site import SiteModel
from app.core.types import Output, TrackPoint
from app.sessions.batch import (
    BatchConflictError,
    ClockChangedError,
    IncomingBatch,
    SessionOverError,
    Submitted,
    UnknownSiteError,
)
from app.sessions.clock import is_same_clock, logged_batch, settled_clock
from app.sessions.hub import Hub
from app.sessions.limits import SessionLimits
from app.sessions.mailbox import Mailbox
from app.sessions.ports import Clock, SessionPorts, SiteSource
from app.sessions.worker import DeviceSession

T = TypeVar("T")

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class _Slot:
    """An unfinished session: in memory (``live``) or asleep in its snapshot."""

    record: SessionRecord
    seen_s: float
    provisional: bool
    live: DeviceSession | None = None


@dataclass(slots=True)
class _Device:
    device_id: str
    mailbox: Mailbox
    slots: dict[str, _Slot] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Latest:
    site_id: str
    output: Output


class SessionRegistry:
    """All live sessions of this process.

    A batch is appended to the log, folded, answered, in this order; a device's batches one after
    the other. A phone that comes back to a finished session opens it again: its track is folded
    from the entire log when it is settled or finished the next time.
    """

    def __init__(
        self,
        ports: SessionPorts,
        sites: SiteSource,
        hub: Hub,
        clock: Clock,
        limits: SessionLimits | None = None,
    ) -> None:
        self._ports = ports
        self._sites = sites
        self._hub = hub
        self._clock = clock
        self._limits = limits or SessionLimits()
        self._devices: dict[str, _Device] = {}
        self._latest: dict[str, _Latest] = {}

    async def submit(self, batch: IncomingBatch) -> Submitted:
        """Make a batch durable, fold it and answer; a caller who is cancelled stops nothing.

        Raises
        ------
        MailboxFullError, LogUnavailableError
            Not taken; the phone shall send it again later.
        BatchConflictError, ClockChangedError, SessionOverError, UnknownSiteError
            Never to be taken like this.
        """
        device = self._device(batch.device_id)
        return await device.mailbox.offer(lambda: self._serve(device, batch))

    def latest(self, device_id: str) -> tuple[str, Output] | None:
        """Return site and output of the device's newest batch.

        After a restart it is the last stored point, until the device posts again.
        """
        latest = self._latest.get(device_id)
        return None if latest is None else (latest.site_id, latest.output)

    def latest_at(self, site_id: str) -> dict[str, Output]:
        """Return the latest output of every device that was last seen at a site."""
        return {d: x.output for d, x in self._latest.items() if x.site_id == site_id}

    async def explain(self, device_id: str) -> tuple[str, Explanation] | None:
        """Return site and explanation of the device's newest session; None if all are over."""
        device = self._devices.get(device_id)
        return None if device is None else await device.mailbox.run(partial(self._explain, device))

    def pending_points(self, device_id: str) -> dict[str, tuple[TrackPoint, ...]]:
        """Return, by session id, the points that follow the stored ones if nothing more comes.

        Complete after `settle`. Joined with the stored points, these replace stored ones of the
        same time.
        """
        device = self._devices.get(device_id)
        slots = device.slots.values() if device else ()
        return {
            slot.record.session_id: slot.live.pending_points()
            for slot in slots
            if slot.live and self._has_site(slot)
        }

    async def settle(self, device_id: str) -> None:
        """Make the stored tracks of the device's unfinished sessions those of everything logged."""
        device = self._devices.get(device_id)
        if device is not None:
            await device.mailbox.run(partial(self._settle_all, device))

    async def erase(self, device_id: str, remove: Callable[[], Awaitable[None]]) -> None:
        """Forget a device; ``remove`` runs after its earlier batches and before its later ones."""
        device = self._device(device_id)

        async def forget() -> None:
            await remove()
            device.slots.clear()
            self._latest.pop(device_id, None)

        await device.mailbox.run(forget)

    async def recover(self) -> None:
        """Learn at start-up where devices were and which sessions are unfinished.

        A session wakes up when it is needed.
        """
        for last in await self._ports.tracks.last_points():
            self._latest[last.device_id] = _Latest(last.site_id, last.point)
        now_s = self._clock.now_s()
        for record in await self._ports.log.unfinished_sessions():
            slots = self._device(record.device_id).slots
            slots.setdefault(record.session, _Slot(record, now_s, provisional=True))

    async def sweep(self) -> None:
        """Finish sessions that are over, put to sleep those that are silent or too many."""
        now_s = self._clock.now_s()
        asleep_s = max(now_s - self._limits.evict_s, self._seen_s_of_excess())
        for device_id, device in tuple(self._devices.items()):
            for slot in tuple(device.slots.values()):
                if self._is_over(slot):
                    await asyncio.wait([self._post(device, partial(self._finish, device, slot))])
                elif slot.live and slot.seen_s <= asleep_s:
                    await asyncio.wait([self._post(device, partial(self._sleep, slot))])
            if not device.slots and device.mailbox.idle:
                del self._devices[device_id]

    async def close(self) -> None:
        """Save all sessions and wait until everything is stored; submit nothing any more."""
        for device in tuple(self._devices.values()):
            await asyncio.wait([self._post(device, partial(self._sleep_all, device))])
        await self._ports.tracks.flush()

    def _device(self, device_id: str) -> _Device:
        if device_id not in self._devices:
            mailbox = Mailbox(self._limits.mailbox_batches, self._limits.retry_after_s)
            self._devices[device_id] = _Device(device_id, mailbox)
        return self._devices[device_id]

    def _world(self, record: SessionRecord) -> tuple[SiteModel, Params]:
        site = self._sites.current(record.site_id)
        if site is None:
            raise UnknownSiteError(record.site_id)
        return site, self._sites.params(record.site_id, record.profile)

    def _has_site(self, slot: _Slot) -> bool:
        return self._sites.current(slot.record.site_id) is not None

    async def _serve(self, device: _Device, batch: IncomingBatch) -> Submitted:
        if self._sites.current(batch.site_id) is None:
            raise UnknownSiteError(batch.site_id)
        slot = device.slots.get(batch.session) or await self._open(device, batch)
        record = slot.record
        if record.site_id != batch.site_id or not is_same_clock(record.clock, batch.clock):
            raise ClockChangedError(batch.session)
        session = await self._awake(slot)
        changed = await self._follow_profile(slot, session, batch.profile)
        changed = await self._follow_clock(slot, session, batch) or changed
        record = slot.record
        slot.seen_s = self._clock.now_s()
        logged = logged_batch(batch, record.session_id, record.clock, record.opened_s)
        stored = await self._append(session, logged)
        if stored is logged or session.is_unconfirmed(batch.seq):
            changed = await self._fold(slot, session, stored) or changed
        output = session.output()
        if changed and output is not None:
            self._show(record, output)
        if session.snapshot_due:
            self._post(device, session.snapshot)
        return Submitted(
            session_id=record.session_id,
            accepted=len(stored.observations),
            rejected=stored.rejected,
            ignored=stored.ignored,
            output=output,
            duplicate=stored is not logged,
            waiting=stored.monotonic_count if record.clock.mono_to_wall_s is None else 0,
            observations=(
                tuple(each_in_event_time(logged, record.clock)) if stored is logged else ()
            ),
        )

    async def _open(self, device: _Device, batch: IncomingBatch) -> _Slot:
        opened = SessionRecord(
            session_id=uuid.uuid4().hex,
            device_id=batch.device_id,
            session=batch.session,
            site_id=batch.site_id,
            profile=batch.named_profile or batch.profile,
            clock=settled_clock(SessionClock(batch.clock.recorded), batch, batch.received_s),
            opened_s=batch.received_s,
            profile_named=batch.named_profile is not None,
        )
        record = await self._ports.log.open_session(opened)
        if record.finished:
            if batch.received_s - record.opened_s > self._limits.reopen_s:
                raise SessionOverError(batch.session)
            await self._ports.log.reopen_session(record.session_id)
        slot = _Slot(record, batch.received_s, provisional=record.session_id != opened.session_id)
        if not slot.provisional:
            slot.live = self._new_session(record)
        device.slots[batch.session] = slot
        return slot

    def _new_session(self, record: SessionRecord) -> DeviceSession:
        return DeviceSession(record, self._world, self._ports, self._limits)

    async def _awake(self, slot: _Slot) -> DeviceSession:
        if slot.live is None:
            session = self._new_session(slot.record)
            await session.recover(provisional=slot.provisional)
            slot.live = session
        return slot.live

    async def _follow_profile(self, slot: _Slot, session: DeviceSession, profile: str) -> bool:
        """Let a session that named no profile change to the one that it would be opened with now.

        Stored before anything is told with it: after a crash the session goes on with it.
        """
        if slot.record.profile_named or slot.record.profile == profile:
            return False
        await session.settle()
        await self._ports.tracks.flush()
        since_s = session.folded_until_s
        switched = replace(slot.record, profile=profile, profile_since_s=since_s)
        await self._ports.log.switch_profile(switched)
        slot.record = switched
        await self._undoubted(slot, session.switch(switched))
        return True

    async def _follow_clock(
        self, slot: _Slot, session: DeviceSession, batch: IncomingBatch
    ) -> bool:
        """Let the session's clock be what this batch and all before it tell together.

        Stored before the batch: what is acknowledged is timed by the same clock after a crash.
        """
        record = slot.record
        clock = settled_clock(record.clock, batch, record.opened_s)
        if clock == record.clock:
            return False
        settled = replace(record, clock=clock)
        await self._ports.log.settle_clock(settled)
        slot.record = settled
        return await self._undoubted(slot, session.settle_clock(settled))

    async def _append(self, session: DeviceSession, batch: LoggedBatch) -> LoggedBatch:
        try:
            stored = await self._ports.log.append(batch, session.record.clock)
        except LogUnavailableError:
            session.mark_unconfirmed(batch.seq)
            raise
        if stored.digest != batch.digest:
            raise BatchConflictError(batch.seq)
        return stored

    async def _fold(self, slot: _Slot, session: DeviceSession, batch: LoggedBatch) -> bool:
        # Half a batch may be folded otherwise: what comes next would start from it.
        return await self._undoubted(slot, session.take(batch))

    async def _undoubted(self, slot: _Slot, fold: Awaitable[T]) -> T:
        """Return what a fold comes to; if it breaks off, what comes next starts from the log."""
        try:
            return await fold
        except Exception:
            slot.live, slot.provisional = None, True
            raise

    def _show(self, record: SessionRecord, output: Output) -> None:
        self._latest[record.device_id] = _Latest(record.site_id, output)
        self._hub.publish(record.site_id, record.device_id, output)

    async def _explain(self, device: _Device) -> tuple[str, Explanation] | None:
        slots = [slot for slot in device.slots.values() if self._has_site(slot)]
        if not slots:
            return None
        slot = max(slots, key=lambda slot: (slot.seen_s, slot.record.opened_s))
        explanation = (await self._awake(slot)).explained()
        return None if explanation is None else (slot.record.site_id, explanation)

    async def _settle_all(self, device: _Device) -> None:
        for slot in device.slots.values():
            if self._has_site(slot):
                session = await self._awake(slot)
                await session.settle()
        await self._ports.tracks.flush()

    def _post(self, device: _Device, job: Callable[[], Awaitable[None]]) -> "asyncio.Task[None]":
        # One device's trouble is not the others': it is logged, and the next batch or sweep tries
        # again.
        task = device.mailbox.post(job)
        task.add_done_callback(partial(_log_failure, device.device_id))
        return task

    def _is_over(self, slot: _Slot) -> bool:
        return slot.seen_s <= self._clock.now_s() - self._limits.idle_s

    async def _finish(self, device: _Device, slot: _Slot) -> None:
        # Before this job's turn the phone may have come back, or the device been erased.
        if not self._is_over(slot) or device.slots.get(slot.record.session) is not slot:
            return
        if self._has_site(slot):
            session = await self._awake(slot)
            await session.finish()
        del device.slots[slot.record.session]

    async def _sleep(self, slot: _Slot) -> None:
        if slot.live is not None:
            await slot.live.snapshot()
            slot.provisional, slot.live = slot.live.provisional, None

    async def _sleep_all(self, device: _Device) -> None:
        for slot in device.slots.values():
            await self._sleep(slot)

    def _seen_s_of_excess(self) -> float:
        slots = (slot for device in self._devices.values() for slot in device.slots.values())
        seen_s = sorted((slot.seen_s for slot in slots if slot.live), reverse=True)
        excess = seen_s[self._limits.max_sessions :]
        return excess[0] if excess else -math.inf


def _log_failure(device_id: str, task: "asyncio.Task[None]") -> None:
    if not task.cancelled() and (error := task.exception()):
        logger.error("device %s: %r", device_id, error, exc_info=error)
