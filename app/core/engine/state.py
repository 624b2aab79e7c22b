"""The state of one session's fold."""

from dataclasses import dataclass

from app.core.engine.order import OrderKey


@dataclass(frozen=True, slots=True)
class SessionState:
    """Everything a session remembers; immutable, so any older state is a checkpoint.

    Attributes
    ----------
    last_key
        Order key of the last observation folded; None before the first.
    latest_s
        The latest instant any folded observation speaks of.
    """

    last_key: OrderKey | None = None
    latest_s: float | None = None
