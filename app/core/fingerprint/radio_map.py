"""The radio map: a site's fingerprints as one immutable sparse matrix with an inverted index."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from app.core.types import BoolArray, FloatArray, IntArray

WIFI, BLE = 0, 1


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """A surveyed place and the levels heard there.

    Attributes
    ----------
    wifi_dbm, ble_dbm
        Level per transmitter key (see `Reading.keys`).
    survey_walk
        Which walk or reference point it came from; leave-one-walk-out validation groups by it.
    time_s
        When it was taken, None if that is not known.
    """

    floor_index: int
    x_m: float
    y_m: float
    wifi_dbm: dict[str, float]
    ble_dbm: dict[str, float]
    survey_walk: str = ""
    time_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class RadioMap:
    """Fingerprints (rows) by transmitters (columns), stored row-wise and inverted column-wise.

    Attributes
    ----------
    floor_ids
        Floors that ``floor_index`` refers to; must equal the site's floor order.
    floor_index, x_m, y_m : (rows,)
        Where each fingerprint was taken.
    survey_walks : (rows,)
        Walk of each row.
    transmitters : (columns,)
        Key of each column.
    radio : (columns,)
        `WIFI` or `BLE`.
    row_start : (rows + 1,), column : (entries,), rssi_dbm : (entries,)
        Compressed sparse rows.
    column_start : (columns + 1,), row : (entries,), column_rssi_dbm : (entries,)
        The same entries by column: the inverted index that matchers walk.
    """

    floor_ids: tuple[str, ...]
    floor_index: IntArray
    x_m: FloatArray
    y_m: FloatArray
    survey_walks: tuple[str, ...]
    transmitters: tuple[str, ...]
    radio: IntArray
    row_start: IntArray
    column: IntArray
    rssi_dbm: FloatArray
    column_start: IntArray = field(init=False, repr=False)
    row: IntArray = field(init=False, repr=False)
    column_rssi_dbm: FloatArray = field(init=False, repr=False)
    column_by_key: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows = np.repeat(np.arange(self.rows), np.diff(self.row_start))
        order = np.argsort(self.column, kind="stable")
        counts = np.bincount(self.column, minlength=len(self.transmitters))
        object.__setattr__(self, "column_start", np.concatenate(([0], np.cumsum(counts))))
        object.__setattr__(self, "row", rows[order])
        object.__setattr__(self, "column_rssi_dbm", self.rssi_dbm[order])
        index = {key: i for i, key in enumerate(self.transmitters)}
        object.__setattr__(self, "column_by_key", index)

    @property
    def rows(self) -> int:
        """Number of fingerprints."""
        return len(self.x_m)

    def with_floors(self, floor_ids: Sequence[str]) -> "RadioMap":
        """Return the map with rows pointing into ``floor_ids``, without rows of other floors.

        Raises
        ------
        ValueError
            If no floor of the map is among ``floor_ids``.
        """
        if tuple(floor_ids) == self.floor_ids:
            return self
        position = {floor_id: i for i, floor_id in enumerate(floor_ids)}
        new_index = np.array([position.get(f, -1) for f in self.floor_ids], dtype=np.int64)
        floor_index = new_index[self.floor_index]
        keep = floor_index >= 0
        if not keep.any():
            msg = f"the radio map knows floors {self.floor_ids}, none of {tuple(floor_ids)}"
            raise ValueError(msg)
        renamed = replace(self, floor_ids=tuple(floor_ids), floor_index=floor_index)
        return renamed.of_rows(keep)

    def of_rows(self, keep: BoolArray) -> "RadioMap":
        """Return the map with these rows (rows,) only; columns stay, heard or not."""
        entries = np.repeat(keep, np.diff(self.row_start))
        return replace(
            self,
            floor_index=self.floor_index[keep],
            x_m=self.x_m[keep],
            y_m=self.y_m[keep],
            survey_walks=tuple(w for w, k in zip(self.survey_walks, keep, strict=True) if k),
            row_start=np.concatenate(([0], np.cumsum(np.diff(self.row_start)[keep]))),
            column=self.column[entries],
            rssi_dbm=self.rssi_dbm[entries],
        )

    def without_transmitters(self, keys: Collection[str]) -> "RadioMap":
        """Return the map as if these transmitters were not there; rows stay, though silent."""
        keep = np.array([key not in keys for key in self.transmitters], dtype=np.bool_)
        if keep.all():
            return self
        entries = keep[self.column]
        rows = np.repeat(np.arange(self.rows), np.diff(self.row_start))[entries]
        counts = np.bincount(rows, minlength=self.rows)
        return replace(
            self,
            transmitters=tuple(t for t, k in zip(self.transmitters, keep, strict=True) if k),
            radio=self.radio[keep],
            row_start=np.concatenate(([0], np.cumsum(counts))),
            column=(np.cumsum(keep) - 1)[self.column[entries]],
            rssi_dbm=self.rssi_dbm[entries],
        )


def joined(radio_map: RadioMap, more: Sequence[Fingerprint]) -> RadioMap:
    """Return the map with further fingerprints at its end."""
    added = build_radio_map(radio_map.floor_ids, more)
    columns = dict(radio_map.column_by_key)
    radio = [*radio_map.radio.tolist()]
    for key, kind in zip(added.transmitters, added.radio.tolist(), strict=True):
        if key not in columns:
            columns[key] = len(columns)
            radio.append(kind)
    renamed = np.array([columns[key] for key in added.transmitters], dtype=np.int64)
    return RadioMap(
        floor_ids=radio_map.floor_ids,
        floor_index=np.concatenate([radio_map.floor_index, added.floor_index]),
        x_m=np.concatenate([radio_map.x_m, added.x_m]),
        y_m=np.concatenate([radio_map.y_m, added.y_m]),
        survey_walks=(*radio_map.survey_walks, *added.survey_walks),
        transmitters=tuple(columns),
        radio=_ints(radio),
        row_start=np.concatenate(
            [radio_map.row_start, radio_map.row_start[-1] + added.row_start[1:]]
        ),
        column=np.concatenate([radio_map.column, renamed[added.column]]),
        rssi_dbm=np.concatenate([radio_map.rssi_dbm, added.rssi_dbm]),
    )


def build_radio_map(floor_ids: Sequence[str], fingerprints: Iterable[Fingerprint]) -> RadioMap:
    """Join fingerprints to one map; columns are the transmitters in order of first appearance."""
    columns: dict[str, int] = {}
    radio: list[int] = []
    row_start, column, rssi_dbm = [0], [], []
    kept: list[Fingerprint] = []
    for fingerprint in fingerprints:
        kept.append(fingerprint)
        for kind, levels in ((WIFI, fingerprint.wifi_dbm), (BLE, fingerprint.ble_dbm)):
            for key, level_dbm in levels.items():
                if key not in columns:
                    columns[key] = len(columns)
                    radio.append(kind)
                column.append(columns[key])
                rssi_dbm.append(level_dbm)
        row_start.append(len(column))
    return RadioMap(
        floor_ids=tuple(floor_ids),
        floor_index=_ints([f.floor_index for f in kept]),
        x_m=np.array([f.x_m for f in kept], dtype=np.float64),
        y_m=np.array([f.y_m for f in kept], dtype=np.float64),
        survey_walks=tuple(f.survey_walk for f in kept),
        transmitters=tuple(columns),
        radio=_ints(radio),
        row_start=_ints(row_start),
        column=_ints(column),
        rssi_dbm=np.array(rssi_dbm, dtype=np.float64),
    )


def _ints(values: list[int]) -> npt.NDArray[np.int64]:
    return np.array(values, dtype=np.int64)
