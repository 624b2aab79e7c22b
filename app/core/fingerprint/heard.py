"""A query in the columns of a radio map: looked up once, matched as often as needed."""

from dataclasses import dataclass

import numpy as np

from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Levels of the transmitters of one radio, in the order of their keys.

    The order makes sums independent of how the phone listed them.

    Attributes
    ----------
    column : (n,)
        Columns of the map; -1: the map does not know the transmitter.
    level_dbm : (n,)
        Their levels.
    """

    column: IntArray
    level_dbm: FloatArray

    def __len__(self) -> int:
        return len(self.column)

    def less(self, offset_db: float) -> "Levels":
        """Return the levels as a phone heard them that hears so much less."""
        return Levels(self.column, self.level_dbm - offset_db)


_NOTHING = Levels(np.empty(0, dtype=np.int64), np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What a query holds, per radio."""

    wifi: Levels
    ble: Levels

    def less(self, offset_db: float) -> "Heard":
        """Return what a phone would have heard that hears so much less."""
        return Heard(self.wifi.less(offset_db), self.ble.less(offset_db))

    @property
    def is_known(self) -> bool:
        """Whether the map knows any of the transmitters."""
        return bool((self.wifi.column >= 0).any() or (self.ble.column >= 0).any())


def heard_in(query: Query, radio_map: RadioMap) -> Heard:
    """Return a query in the columns of a map."""
    return Heard(_levels(query.wifi_dbm, radio_map), _levels(query.ble_dbm, radio_map))


def _levels(levels_dbm: dict[str, float], radio_map: RadioMap) -> Levels:
    if not levels_dbm:
        return _NOTHING
    keys, columns = sorted(levels_dbm), radio_map.column_by_key
    return Levels(
        np.array([columns.get(key, -1) for key in keys], dtype=np.int64),
        np.array([levels_dbm[key] for key in keys], dtype=np.float64),
    )
