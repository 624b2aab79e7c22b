"""Transmitters that a radio map must not hold, on evidence: they moved, or changed their address.

A phone's hotspot goes where its carrier goes; a phone or a tracker takes a new address every
quarter of an hour. Both are found by what was heard, never by how an address looks: of the readings
in a shopping centre four in five carry the locally administered bit, and are of access points.

**Moved.** At the reference level ``u`` (1 m, the loudest there is) and the loss of free space, a
level ``l`` was heard within::

    reach(l) = 10^((u - l) / 20)    m

of its transmitter. Two scans at places farther apart than the sum of their reaches, and a slack for
how well places are known, cannot both have heard one transmitter at one place. A single false level
must not condemn a transmitter: such a pair must be left without the scan that has most of them.

**Rotated.** An address that was heard only within ``rotation_s``, by a share ``p`` of the scans
made then around the places where it was heard, and by none of the n scans made there at other
times, is still on the air with a chance of at most ``(1 - p)^n``; below ``chance_ratio`` it is
taken for gone. Scans of walks that heard nothing at all of its radio (an iPhone hears no Wi-Fi)
count neither way.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial import cKDTree

from app.core.fingerprint.radio_map import BLE, WIFI, Fingerprint, RadioMap, build_radio_map
from app.core.types import BoolArray, FloatArray, IntArray


class Reason(StrEnum):
    """Why a transmitter is kept out."""

    MOVED = "moved"
    ROTATED = "rotated"


@dataclass(frozen=True, slots=True)
class WanderingParams:
    """What counts as evidence.

    Attributes
    ----------
    wifi_ref_dbm, ble_ref_dbm
        Loudest level at 1 m: 20 dBm of Wi-Fi less 40 dB of free space at 2.4 GHz and 3 dB of
        antennas; Bluetooth at 10 dBm.
    slack_m
        How far two places may be wrong together: a scan's readings are seconds old.
    most_loud
        So many of the loudest scans are compared with each other.
    rotation_s
        Longest life of an address that rotates: 15 minutes as Bluetooth recommends, and some more.
    near_m
        Scans this near to a place where it was heard would hear it again.
    least_scans
        Scans made there at other times; with fewer there is no evidence.
    least_heard
        Scans that heard it, for ``p`` to mean something.
    chance_ratio
        Bound on (1 - p)^n. Thousands of addresses are asked, hence so small.
    """

    wifi_ref_dbm: float = -17.0
    ble_ref_dbm: float = -27.0
    slack_m: float = 10.0
    most_loud: int = 300
    rotation_s: float = 1_200.0
    near_m: float = 4.0
    least_scans: int = 5
    least_heard: int = 3
    chance_ratio: float = 1e-6


@dataclass(frozen=True, slots=True)
class Wanderer:
    """A transmitter that is kept out, and why.

    Attributes
    ----------
    evidence
        In words, with the numbers.
    """

    key: str
    reason: Reason
    evidence: str


def wanderers(fingerprints: Sequence[Fingerprint], params: WanderingParams) -> tuple[Wanderer, ...]:
    """Return the transmitters of a survey that moved or changed their address, by key."""
    floors = range(max((f.floor_index for f in fingerprints), default=-1) + 1)
    heard = build_radio_map([str(floor) for floor in floors], fingerprints)
    # An unknown time is nan.
    time_s = np.array([f.time_s for f in fingerprints], dtype=np.float64)
    moved = {wanderer.key: wanderer for wanderer in _moved(heard, params)}
    rotated = {wanderer.key: wanderer for wanderer in _rotated(heard, time_s, params)}
    return tuple(sorted((rotated | moved).values(), key=lambda wanderer: wanderer.key))


def without(fingerprints: Sequence[Fingerprint], keys: frozenset[str]) -> list[Fingerprint]:
    """Return the fingerprints without some transmitters; those that have no other are gone."""
    kept = []
    for fingerprint in fingerprints:
        wifi_dbm = {k: v for k, v in fingerprint.wifi_dbm.items() if k not in keys}
        ble_dbm = {k: v for k, v in fingerprint.ble_dbm.items() if k not in keys}
        if wifi_dbm or ble_dbm:
            kept.append(replace(fingerprint, wifi_dbm=wifi_dbm, ble_dbm=ble_dbm))
    return kept


def _moved(heard: RadioMap, params: WanderingParams) -> Iterator[Wanderer]:
    places = np.column_stack([heard.x_m, heard.y_m])
    for column, key in enumerate(heard.transmitters):
        entries = slice(heard.column_start[column], heard.column_start[column + 1])
        is_ble = heard.radio[column] == BLE
        ref_dbm = params.ble_ref_dbm if is_ble else params.wifi_ref_dbm
        level_dbm = heard.column_rssi_dbm[entries]
        found = _farthest_contradiction(places[heard.row[entries]], level_dbm, ref_dbm, params)
        if found is not None:
            one, other, apart_m = found
            evidence = (
                f"heard at {level_dbm[one]:.0f} and at {level_dbm[other]:.0f} dBm at places "
                f"{apart_m:.0f} m apart"
            )
            yield Wanderer(key, Reason.MOVED, evidence)


def _farthest_contradiction(
    places: FloatArray, level_dbm: FloatArray, ref_dbm: float, params: WanderingParams
) -> tuple[int, int, float] | None:
    """Return two scans that cannot have heard one place, by how far they are beyond; else None."""
    reach_m = 10.0 ** ((ref_dbm - level_dbm) / 20.0)
    extent_m = float(np.linalg.norm(np.ptp(places, axis=0)))
    loud = np.flatnonzero(reach_m + reach_m.min() + params.slack_m < extent_m)
    # A hotspot in the surveyor's pocket is loud everywhere; some hundred scans prove it as well.
    loud = loud[np.argsort(reach_m[loud], kind="stable")[: params.most_loud]]
    if len(loud) < 3:
        return None
    apart_m = np.linalg.norm(places[loud, None] - places[None, loud], axis=2)
    beyond_m = apart_m - reach_m[loud, None] - reach_m[None, loud] - params.slack_m
    worst = int(np.argmax((beyond_m > 0.0).sum(axis=0)))
    beyond_m[worst], beyond_m[:, worst] = -1.0, -1.0
    one, other = divmod(int(np.argmax(beyond_m)), len(loud))
    if beyond_m[one, other] <= 0.0:
        return None
    return int(loud[one]), int(loud[other]), float(apart_m[one, other])


def _rotated(heard: RadioMap, time_s: FloatArray, params: WanderingParams) -> Iterator[Wanderer]:
    near = _near_scans(heard, params)
    listens = [_listening(heard, radio) for radio in (WIFI, BLE)]
    for column, key in enumerate(heard.transmitters):
        rows = heard.row[heard.column_start[column] : heard.column_start[column + 1]]
        span_s = float(np.ptp(time_s[rows]))
        # Unknown times (nan) are no evidence: every comparison with them is false.
        if len(rows) < params.least_heard or not span_s <= params.rotation_s:
            continue
        around = np.unique(np.concatenate([near[row] for row in rows.tolist()]))
        around = around[listens[heard.radio[column]][around]]
        first_s, last_s = time_s[rows].min(), time_s[rows].max()
        then = (time_s[around] >= first_s) & (time_s[around] <= last_s)
        # Other than by one life of the address, so that it cannot have been just before or after.
        other = (time_s[around] < last_s - params.rotation_s) | (
            time_s[around] > first_s + params.rotation_s
        )
        missed, share = int(other.sum()), len(rows) / int(then.sum())
        if missed >= params.least_scans and (1.0 - share) ** missed <= params.chance_ratio:
            evidence = (
                f"heard by {len(rows)} of {int(then.sum())} scans within {span_s / 60.0:.0f} min, "
                f"by none of {missed} around there at other times"
            )
            yield Wanderer(key, Reason.ROTATED, evidence)


def _listening(heard: RadioMap, radio: int) -> BoolArray:
    """Return which scans (rows,) are of walks that heard this radio at all."""
    rows = np.unique(heard.row[np.repeat(heard.radio == radio, np.diff(heard.column_start))])
    walks = {heard.survey_walks[row] for row in rows.tolist()}
    return np.array([walk in walks for walk in heard.survey_walks], dtype=np.bool_)


def _near_scans(heard: RadioMap, params: WanderingParams) -> list[IntArray]:
    """Return for each scan those near it on its floor, itself too."""
    near: list[IntArray] = [np.empty(0, dtype=np.int64)] * heard.rows
    places = np.column_stack([heard.x_m, heard.y_m])
    for floor in np.unique(heard.floor_index):
        rows = np.flatnonzero(heard.floor_index == floor)
        tree = cKDTree(places[rows])
        around = tree.query_ball_point(places[rows], params.near_m)
        for row, found in zip(rows.tolist(), around, strict=True):
            near[row] = rows[found]
    return near
