"""The bounds of live sessions, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SessionLimits:
    """How long and how much; all of it can be set without changing any stored track.

    Attributes
    ----------
    mailbox_batches
        Batches of one device in hand at once: about a minute of live batches, 64 MiB at worst.
    retry_after_s
        What a phone is told to wait when its mailbox is full: a few batches are folded by then.
    reorder_window_s
        Event time over which late observations are folded in at once: longer than a phone's batch
        plus a retry, short enough to fold again within one reply.
    evict_s
        Silence after which a session leaves memory for its snapshot: mostly, phones are back from a
        dead spot sooner.
    idle_s
        Silence after which a session is over and its final track is stored.
    reopen_s
        A finished session is opened again for a phone that comes back within this time of its
        opening: its track is then folded anew, for which the log must still be whole (raw IMU
        leaves it after 24 h).
    snapshot_every_s
        Event time between snapshots: what a restart folds again per session.
    max_sessions
        Sessions in memory: some 100 kB each, 1 GB in all.
    fold_chunk
        Observations folded between two looks at other work: some milliseconds.
    """

    mailbox_batches: int = 64
    retry_after_s: float = 1.0
    reorder_window_s: float = 5.0
    evict_s: float = 180.0
    idle_s: float = 600.0
    reopen_s: float = 12 * 3600.0
    snapshot_every_s: float = 30.0
    max_sessions: int = 10_000
    fold_chunk: int = 32
