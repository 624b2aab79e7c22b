"""The ports of sessions in memory, and a fold whose every output tells all that came before it."""

import asyncio
import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from app.core.engine import SessionState, in_order, order_key
from app.core.params import Params
from app.core.session import (
    LastPoint,
    LoggedBatch,
    LogUnavailableError,
    SessionClock,
    SessionRecord,
    event_time_s,
    event_times,
)
from app.core.site import Floor, SiteModel
from app.core.types import (
    Method,
    MotionMode,
    NoFix,
    NoFixReason,
    Observation,
    Output,
    Steps,
    TrackPoint,
    Used,
)
from app.sessions.batch import ClockReport, IncomingBatch, IncomingRecord
from app.sessions.hub import Hub
from app.sessions.limits import SessionLimits
from app.sessions.ports import SessionPorts
from app.sessions.registry import SessionRegistry

START_S = 1_763_769_600.0
SITE = SiteModel("site", 1, (Floor("floor", "Ground", "Hall", 0, 0.0, 0.0, 50.0, 30.0),))
PARAMS = Params()
# Like the engine, the fold stops to report this long after the phone's last word.
SILENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class ChainState(SessionState):
    """A hash chain over everything folded."""

    chain: bytes = b""


class ChainFold:
    """Reports positions that are digests of the fold so far: any other order shows at once."""

    def start(self) -> SessionState:
        return ChainState()

    def advance(
        self, state: SessionState, observation: Observation, site: SiteModel, params: Params
    ) -> tuple[SessionState, tuple[Output, ...]]:
        assert isinstance(state, ChainState)
        key = order_key(observation)
        assert state.last_key is None or key > state.last_key, "folded out of order or twice"
        outputs = _seconds(state, observation.time_s)
        latest_s = max(event_time_s(observation), state.latest_s or -math.inf)
        link = f"{params.profile} {key!r}".encode()
        chain = hashlib.blake2b(state.chain + link, digest_size=8).digest()
        return ChainState(key, latest_s, observation.time_s, chain=chain), outputs

    def finish(self, state: SessionState, site: SiteModel, params: Params) -> tuple[Output, ...]:
        assert isinstance(state, ChainState)
        if state.latest_s is None:
            return ()
        return (*_seconds(state, state.latest_s), _report(state, state.latest_s))

    def smoothed(
        self, observations: Sequence[Observation], site: SiteModel, params: Params
    ) -> tuple[TrackPoint, ...]:
        return tuple(straight_track(observations, self, params.profile))


def _seconds(state: ChainState, to_s: float) -> tuple[Output, ...]:
    if state.now_s is None or state.latest_s is None:
        return ()
    until_s = min(to_s, state.latest_s + SILENCE_S)
    return tuple(
        _report(state, float(s)) for s in range(math.ceil(state.now_s), math.ceil(until_s))
    )


def _report(state: ChainState, time_s: float) -> Output:
    if state.chain[0] % 4 == 0:
        return NoFix(time_s, NoFixReason.NOTHING_HEARD)
    x_m = float(int.from_bytes(state.chain[:6]))
    return TrackPoint(
        time_s=time_s,
        floor_id="floor",
        x_m=x_m,
        y_m=0.0,
        covariance_m2=(1.0, 0.0, 1.0),
        radius95_m=2.4,
        speed_mps=0.0,
        heading_rad=None,
        motion=MotionMode.STILL,
        method=Method.FUSED,
        floor_confidence=1.0,
        used=Used(),
        age_s=0.0,
    )


def straight_track(
    observations: Sequence[Observation], fold: ChainFold, profile: str = "best"
) -> list[TrackPoint]:
    """Return the track of observations folded in order, without any session around it."""
    state, outputs, params = fold.start(), [], replace(PARAMS, profile=profile)
    for observation in in_order(observations):
        state, more = fold.advance(state, observation, SITE, params)
        outputs += more
    outputs += fold.finish(state, SITE, params)
    by_time = {o.time_s: o for o in outputs if isinstance(o, TrackPoint)}
    return [by_time[time_s] for time_s in sorted(by_time)]


@dataclass
class ManualClock:
    """Time stands still until it is moved."""

    time_s: float = START_S

    def now_s(self) -> float:
        return self.time_s


@dataclass
class OneSite:
    """A directory of one site, or of none."""

    site: SiteModel | None = SITE

    def current(self, site_id: str) -> SiteModel | None:
        return self.site if site_id == SITE.site_id else None

    def params(self, site_id: str, profile: str) -> Params:
        return replace(PARAMS, profile=profile)


class ProcessDiedError(Exception):
    """The process died between the commit and the fold."""


@dataclass
class MemoryLog:
    """A log that survives its registry; it can refuse, be slow or take the process down."""

    sessions: dict[tuple[str, str], SessionRecord] = field(default_factory=dict)
    batches: dict[str, dict[int, LoggedBatch]] = field(default_factory=dict)
    snapshots: dict[str, tuple[str, SessionState]] = field(default_factory=dict)
    refusing: bool = False
    refusing_after_commit: bool = False
    dying_after_commit: bool = False
    gate: asyncio.Event | None = None
    turns: Callable[[LoggedBatch], int] = lambda batch: 1
    reads: int = 0

    async def open_session(self, record: SessionRecord) -> SessionRecord:
        return self.sessions.setdefault((record.device_id, record.session), record)

    async def unfinished_sessions(self) -> list[SessionRecord]:
        return [r for r in self.sessions.values() if not r.finished]

    async def settle_clock(self, record: SessionRecord) -> None:
        key = record.device_id, record.session
        before = self.sessions[key].clock
        self.sessions[key] = replace(self.sessions[key], clock=record.clock)
        if not record.clock.keeps_times_of(before):
            self.snapshots.pop(record.session_id, None)

    async def append(self, batch: LoggedBatch, clock: SessionClock) -> LoggedBatch:
        for _ in range(self.turns(batch)):
            await asyncio.sleep(0)
        if self.gate is not None:
            await self.gate.wait()
        if self.refusing:
            raise LogUnavailableError
        stored = self.batches.setdefault(batch.session_id, {}).setdefault(batch.seq, batch)
        if self.dying_after_commit:
            raise ProcessDiedError
        if self.refusing_after_commit:
            raise LogUnavailableError
        # What is stored comes back decoded anew, as from a database.
        return batch if stored is batch else replace(stored)

    async def read(self, session_id: str, since_s: float | None = None) -> list[LoggedBatch]:
        self.reads += 1
        batches = self.batches.get(session_id, {}).values()
        if since_s is None:
            return list(batches)
        clocks = {record.session_id: record.clock for record in self.sessions.values()}
        return [
            batch
            for batch in batches
            if any(event_time_s(o) >= since_s for o in event_times([batch], clocks[session_id]))
        ]

    async def finish_session(self, session_id: str) -> None:
        self._set_finished(session_id, finished=True)

    async def switch_profile(self, record: SessionRecord) -> None:
        for key, stored in self.sessions.items():
            if stored.session_id == record.session_id:
                since_s = record.profile_since_s
                self.sessions[key] = replace(
                    stored, profile=record.profile, profile_since_s=since_s
                )

    async def reopen_session(self, session_id: str) -> None:
        self._set_finished(session_id, finished=False)

    def _set_finished(self, session_id: str, *, finished: bool) -> None:
        for key, record in self.sessions.items():
            if record.session_id == session_id:
                self.sessions[key] = replace(record, finished=finished, profile_since_s=None)


class MemoryHistory:
    """Tracks and snapshots behind one ordered writer; what it has not written dies with a crash."""

    def __init__(self) -> None:
        self.tracks: dict[str, dict[int, TrackPoint]] = {}
        self.snapshots: dict[str, tuple[str, SessionState]] = {}
        self.sessions: dict[tuple[str, str], SessionRecord] = {}
        self.queue: list[Callable[[], None]] = []
        self.refusing = False
        self.saved = 0

    def write(self, session_id: str, points: Sequence[TrackPoint]) -> None:
        self.queue.append(lambda: self._store(session_id, points))

    def replace_from(self, session_id: str, from_s: float, points: Sequence[TrackPoint]) -> None:
        self.queue.append(lambda: self._replace(session_id, from_s, points))

    async def flush(self) -> None:
        if self.refusing:
            raise LogUnavailableError
        self.crash(kept=len(self.queue))

    async def last_points(self) -> list[LastPoint]:
        last: dict[str, LastPoint] = {}
        for r in sorted(self.sessions.values(), key=lambda r: r.opened_s):
            if track := self.track(r.session_id):
                last[r.device_id] = LastPoint(r.device_id, r.session_id, r.site_id, track[-1])
        return list(last.values())

    async def save(self, session_id: str, profile: str, state: SessionState) -> None:
        self.queue.append(lambda: self.snapshots.update({session_id: (profile, state)}))
        await self.flush()
        self.saved += 1

    async def load(self, session_id: str, profile: str) -> SessionState | None:
        stored = self.snapshots.get(session_id)
        return stored[1] if stored is not None and stored[0] == profile else None

    def crash(self, kept: int) -> None:
        """Write the first of what waits; forget the rest."""
        for operation in self.queue[:kept]:
            operation()
        self.queue.clear()

    def track(self, session_id: str) -> list[TrackPoint]:
        """Return what is stored of a session, in order."""
        points = self.tracks.get(session_id, {})
        return [points[time_us] for time_us in sorted(points)]

    def _store(self, session_id: str, points: Sequence[TrackPoint]) -> None:
        track = self.tracks.setdefault(session_id, {})
        track.update({round(p.time_s * 1e6): p for p in points})

    def _replace(self, session_id: str, from_s: float, points: Sequence[TrackPoint]) -> None:
        track = self.tracks.setdefault(session_id, {})
        for time_us in [t for t in track if t >= round(from_s * 1e6)]:
            del track[time_us]
        self._store(session_id, points)


@dataclass
class Server:
    """A server whose process can be killed and started again on what it has stored."""

    limits: SessionLimits = field(default_factory=SessionLimits)
    log: MemoryLog = field(default_factory=MemoryLog)
    history: MemoryHistory = field(default_factory=MemoryHistory)
    clock: ManualClock = field(default_factory=ManualClock)
    sites: OneSite = field(default_factory=OneSite)
    hub: Hub = field(default_factory=Hub)

    def __post_init__(self) -> None:
        self.history.sessions = self.log.sessions
        self.log.snapshots = self.history.snapshots
        self.registry = self._process()

    def _process(self) -> SessionRegistry:
        ports = SessionPorts(self.log, self.history, self.history, ChainFold())
        return SessionRegistry(ports, self.sites, self.hub, self.clock, self.limits)

    async def kill(self, written: int) -> None:
        """Kill the process with so many of the waiting writes done, and start it again."""
        self.history.crash(written)
        self.registry = self._process()
        await self.registry.recover()

    async def run_idle(self) -> None:
        """Let everything fall silent until its final track is stored.

        This fold's final track is its live one: each live session must have had it already.
        """
        live: dict[str, list[TrackPoint]] = {}
        for device_id in {device_id for device_id, _ in self.log.sessions}:
            live |= await self.live_tracks(device_id)
        self.clock.time_s += self.limits.idle_s
        await self.registry.sweep()
        for session_id, track in live.items():
            assert self.history.track(session_id) == track

    async def live_tracks(self, device_id: str) -> dict[str, list[TrackPoint]]:
        """Return what a reader sees of a device's live sessions, each completed."""
        await self.registry.settle(device_id)
        tracks = {}
        for session_id, pending in self.registry.pending_points(device_id).items():
            points = {p.time_s: p for p in (*self.history.track(session_id), *pending)}
            tracks[session_id] = [points[time_s] for time_s in sorted(points)]
        return tracks

    def track(self, session: str = "walk", device_id: str = "phone") -> list[TrackPoint]:
        """Return the stored track of a session by the phone's name for it."""
        return self.history.track(self.log.sessions[device_id, session].session_id)


def steps_at(*times_s: float) -> list[Observation]:
    """Return one step report for each time, counted from the start."""
    return [Steps(START_S + t, count=i) for i, t in enumerate(times_s)]


def batch_of(
    observations: Sequence[Observation], seq: int = 0, session: str = "walk", **fields: object
) -> IncomingBatch:
    """Return a batch as the edge would build it of a recording."""
    records = tuple(IncomingRecord(i, o) for i, o in enumerate(observations))
    batch = IncomingBatch(
        device_id="phone",
        session=session,
        seq=seq,
        digest=repr([order_key(o) for o in observations]).encode(),
        site_id=SITE.site_id,
        profile="best",
        received_s=START_S,
        clock=ClockReport(recorded=True),
        records=records,
    )
    return replace(batch, **fields)  # type: ignore[arg-type]
