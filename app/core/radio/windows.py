"""The window: recent readings per anchor, one immutable value that a session's state can hold."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from app.core.types import BoolArray, FloatArray, IntArray, Reading


def _no_ints() -> IntArray:
    return np.empty(0, dtype=np.int64)


def _no_floats() -> FloatArray:
    return np.empty(0, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Readings of anchors, sorted by anchor, then time, then level, each once.

    The order makes a window independent of how its readings arrived, bit for bit.

    Attributes
    ----------
    anchor_index : (readings,)
        Index into the site's anchors.
    time_s : (readings,)
        When each level was measured (event time).
    rssi_dbm : (readings,)
        Levels.
    """

    anchor_index: IntArray = field(default_factory=_no_ints)
    time_s: FloatArray = field(default_factory=_no_floats)
    rssi_dbm: FloatArray = field(default_factory=_no_floats)

    def __len__(self) -> int:
        return len(self.anchor_index)

    @property
    def anchors_heard(self) -> int:
        """Number of different anchors."""
        return int(len(self) > 0) + int(np.count_nonzero(np.diff(self.anchor_index)))


def window_of(anchor_index: IntArray, time_s: FloatArray, rssi_dbm: FloatArray) -> Window:
    """Return the window of some readings, given as three arrays of one length in any order."""
    order = np.lexsort((rssi_dbm, time_s, anchor_index))
    anchor, time, level = anchor_index[order], time_s[order], rssi_dbm[order]
    fresh = np.ones(len(order), dtype=np.bool_)
    fresh[1:] = (np.diff(anchor) != 0) | (np.diff(time) != 0.0) | (np.diff(level) != 0.0)
    return Window(
        anchor[fresh].astype(np.int64),
        time[fresh].astype(np.float64),
        level[fresh].astype(np.float64),
    )


def window_of_scan(
    readings: Iterable[Reading], time_s: float, anchor_by_key: Mapping[str, int]
) -> Window:
    """Return the readings of one scan that come from known anchors, each at its own time.

    A reading belongs to the first of its keys (most specific first) that names an anchor. The same
    advertisement reported under two names is one reading.
    """
    heard = [
        (anchor_by_key[key], time_s - reading.age_s, reading.rssi_dbm)
        for reading in readings
        if (key := next((k for k in reading.keys if k in anchor_by_key), None)) is not None
    ]
    if not heard:
        return Window()
    anchor, time, level = zip(*heard, strict=True)
    return window_of(np.array(anchor), np.array(time), np.array(level, dtype=np.float64))


def joined(first: Window, second: Window) -> Window:
    """Return the readings of both windows."""
    return window_of(
        np.concatenate((first.anchor_index, second.anchor_index)),
        np.concatenate((first.time_s, second.time_s)),
        np.concatenate((first.rssi_dbm, second.rssi_dbm)),
    )


def within(window: Window, from_s: float, to_s: float) -> Window:
    """Return the readings with ``from_s < time_s <= to_s``."""
    return _select(window, (window.time_s > from_s) & (window.time_s <= to_s))


def of_anchors(window: Window, wanted: BoolArray) -> Window:
    """Return the readings of the anchors (anchors,) wanted, e.g. those of one floor."""
    return _select(window, wanted[window.anchor_index])


def _select(window: Window, keep: BoolArray) -> Window:
    if keep.all():
        return window
    return Window(window.anchor_index[keep], window.time_s[keep], window.rssi_dbm[keep])
