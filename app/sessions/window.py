"""The reorder window: a session's state now, and enough of its past to take in what comes late."""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from operator import attrgetter

from app.core.engine import OrderKey, SessionState
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import Observation, Output
from app.sessions.ports import Fold


@dataclass(frozen=True, slots=True)
class Keyed:
    """An observation with its place in the order of the fold."""

    key: OrderKey
    observation: Observation


_key_of = attrgetter("key")


class ReorderWindow:
    """Folds in key order over the last seconds of event time, whatever order things come in.

    Holds immutable states about one second apart (checkpoints) and what was folded since the oldest
    of them. What belongs before that is too late for the window.
    """

    def __init__(self, fold: Fold, state: SessionState, length_s: float) -> None:
        self.state = state
        self._fold = fold
        self._length_s = length_s
        self._checkpoints = [state]
        self._folded: list[Keyed] = []

    @property
    def checkpoint(self) -> SessionState:
        """The oldest state kept: nothing before it can change any more."""
        return self._checkpoints[0]

    def sift(self, arrived: list[Keyed]) -> tuple[list[Keyed], bool]:
        """Return the unknown observations that fit the window; tell if any is too late for it.

        An observation older than the window counts as late even if it was folded once: the window
        no longer knows it.
        """
        oldest = self.checkpoint.last_key
        fresh = [
            k for k in arrived if _is_before(self.checkpoint, k.key) and not self._is_folded(k.key)
        ]
        late = oldest is not None and any(k.key < oldest for k in arrived)
        return fresh, late

    def rewind(self, key: OrderKey) -> list[Keyed]:
        """Go back to the newest checkpoint before ``key``; return what has to be folded again.

        Nothing happens when ``key`` is the newest.
        """
        if _is_before(self.state, key):
            return []
        while len(self._checkpoints) > 1 and not _is_before(self._checkpoints[-1], key):
            self._checkpoints.pop()
        self.state = self._checkpoints[-1]
        kept = self._count_folded(self.state)
        undone = self._folded[kept:]
        del self._folded[kept:]
        return undone

    def push(self, keyed: Keyed, site: SiteModel, params: Params) -> tuple[Output, ...]:
        """Fold the next observation in order and return its outputs."""
        self._keep_checkpoint(keyed.key[0])
        self.state, outputs = self._fold.advance(self.state, keyed.observation, site, params)
        self._folded.append(keyed)
        self._forget(keyed.key[0] - self._length_s)
        return outputs

    def _keep_checkpoint(self, next_s: float) -> None:
        last_key = self.state.last_key
        if last_key is None or self.state is self._checkpoints[-1]:
            return
        if math.floor(next_s) > math.floor(last_key[0]):
            self._checkpoints.append(self.state)

    def _forget(self, before_s: float) -> None:
        excess = 0
        for checkpoint in self._checkpoints[1:]:
            if checkpoint.last_key is None or checkpoint.last_key[0] > before_s:
                break
            excess += 1
        if excess:
            del self._checkpoints[:excess]
            del self._folded[: self._count_folded(self.checkpoint)]

    def _count_folded(self, state: SessionState) -> int:
        if state.last_key is None:
            return 0
        return bisect_right(self._folded, state.last_key, key=_key_of)

    def _is_folded(self, key: OrderKey) -> bool:
        at = bisect_left(self._folded, key, key=_key_of)
        return at < len(self._folded) and self._folded[at].key == key


def in_order(arrived: list[Keyed]) -> list[Keyed]:
    """Return observations as they are folded: in order, each once."""
    ordered = sorted(arrived, key=_key_of)
    return [k for i, k in enumerate(ordered) if not i or k.key != ordered[i - 1].key]


def merge(fresh: list[Keyed], undone: list[Keyed]) -> list[Keyed]:
    """Return both lists as one in order."""
    return sorted(fresh + undone, key=_key_of)


def _is_before(state: SessionState, key: OrderKey) -> bool:
    return state.last_key is None or state.last_key < key
