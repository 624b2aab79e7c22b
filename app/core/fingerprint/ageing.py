"""Ageing: transmitters that a radio map knows and live traffic contradicts.

Nobody knows where live phones are, but each scan s resembles some fingerprints, and they say what
ought to be heard there; `contradiction` gives for each transmitter t the log-likelihood ratio l_st
of "it is elsewhere now" against "as mapped". Scans of one session in one square say the same thing
again, and count as one, their mean: a phone that lies on a desk all day makes few visits. With V_t
the visits (session and square) that heard or should have heard t, t is suspect where

    x_t = Σ_v mean_{s in v} l_st / (V_t + κ)  >  ``excess``

in nats by visit. It is a mean and not a sum, for small faults of the model would add up with
traffic; κ makes that a few visits suffice only if they are clear. What is suspect misleads the
matching of everything else, so traffic is then matched anew without it, ``passes`` times. Moved
transmitters stand out because the many others still say where the phone is: with most of them moved
there is nothing to find, and a new survey is due.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.core.fingerprint.contradiction import Hearing, Weights, hearings
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams


@dataclass(frozen=True, slots=True)
class AgeingParams:
    """When a transmitter is suspect.

    Chosen on ms2020 (each of folds 1 to 3 as traffic in turn, identities of 10 % permuted), for a
    precision of at least 0.9 on each.

    Attributes
    ----------
    square_m
        Edge of the squares that scans of a session are joined in: about what single fixes err.
    lean
        κ: visits' worth of no evidence.
    excess
        x_t above which a transmitter is suspect.
    least_scans
        An unknown transmitter heard in fewer scans has not appeared, it passed by.
    vanished_share
        Heard less than this share of what is expected, a suspect has vanished; else it has moved.
    passes
        How often traffic is matched; the second time without what the first found.
    """

    square_m: float = 15.0
    lean: float = 40.0
    excess: float = 0.25
    least_scans: int = 5
    vanished_share: float = 0.1
    passes: int = 2


class Change(StrEnum):
    """What became of a transmitter."""

    VANISHED = "vanished"
    MOVED = "moved"
    APPEARED = "appeared"


@dataclass(frozen=True, slots=True)
class Suspect:
    """A transmitter that traffic contradicts, with the evidence.

    Attributes
    ----------
    excess
        x_t in nats; of one that has appeared 0, for the map says nothing of it.
    scans
        In how many scans of the traffic it was heard.
    misplaced
        In how many of them nothing that the scan resembles knows it.
    expected
        In how many scans it ought to have been heard.
    """

    key: str
    change: Change
    excess: float
    scans: int
    misplaced: int
    expected: float


def find_aged(
    traffic: Sequence[Sequence[Query]],
    radio_map: RadioMap,
    weights: Weights,
    matching: MatchParams,
    params: AgeingParams,
) -> list[Suspect]:
    """Return the transmitters that traffic contradicts, the worst first.

    Parameters
    ----------
    traffic
        Single scans by session, named as the map names transmitters (`first_of`).
    weights
        The map's `learned_weights`.
    """
    suspects: list[Suspect] = []
    for _ in range(params.passes):
        left = radio_map.without_transmitters({suspect.key for suspect in suspects})
        evidence = _Evidence(len(radio_map.transmitters))
        for session in traffic:
            # Rows are the same with and without suspects: what the map says of those stays known.
            matched = ((query, match(query, left, matching)) for query in session)
            heard = [scan for scan in hearings(matched, radio_map) if scan is not None]
            evidence.add(heard, weights, params.square_m)
        suspects = evidence.suspects(radio_map, params)
    return sorted(suspects, key=lambda s: (-s.excess, s.key))


class _Evidence:
    """Sums over visits and scans, by transmitter of the map (columns,)."""

    def __init__(self, columns: int) -> None:
        self._against = np.zeros(columns)
        self._visits = np.zeros(columns, dtype=np.int64)
        self._scans = np.zeros(columns, dtype=np.int64)
        self._misplaced = np.zeros(columns, dtype=np.int64)
        self._expected = np.zeros(columns)

    def add(self, session: Sequence[Hearing], weights: Weights, square_m: float) -> None:
        """Add the scans of a session."""
        squares: dict[tuple[int, int, int], list[Hearing]] = {}
        for scan in session:
            square = scan.floor_index, int(scan.x_m // square_m), int(scan.y_m // square_m)
            squares.setdefault(square, []).append(scan)
        for scans in squares.values():
            against, times = np.zeros_like(self._against), np.zeros_like(self._visits)
            for scan in scans:
                against[scan.column] += weights.of(scan)
                times[scan.column] += 1
                self._scans[scan.column] += scan.is_heard
                self._misplaced[scan.column] += scan.is_heard & (scan.presence == 0.0)
                self._expected[scan.column] += scan.presence
            self._against += against / np.maximum(times, 1)
            self._visits += times > 0

    def suspects(self, radio_map: RadioMap, params: AgeingParams) -> list[Suspect]:
        """Return which transmitters are contradicted enough."""
        excess = self._against / (self._visits + params.lean)
        return [
            Suspect(
                key=radio_map.transmitters[t],
                change=self._change(t, params),
                excess=float(excess[t]),
                scans=int(self._scans[t]),
                misplaced=int(self._misplaced[t]),
                expected=float(self._expected[t]),
            )
            for t in np.flatnonzero(excess > params.excess).tolist()
        ]

    def _change(self, column: int, params: AgeingParams) -> Change:
        hardly = params.vanished_share * self._expected[column]
        return Change.VANISHED if self._scans[column] < hardly else Change.MOVED


def appeared(
    traffic: Sequence[Sequence[Query]], radio_map: RadioMap, params: AgeingParams
) -> list[Suspect]:
    """Return transmitters that the map does not know and traffic keeps hearing, often first."""
    scans = Counter(
        key
        for session in traffic
        for query in session
        for key in (*query.wifi_dbm, *query.ble_dbm)
        if key not in radio_map.column_by_key
    )
    return [
        Suspect(key, Change.APPEARED, 0.0, times, times, 0.0)
        for key, times in sorted(scans.items(), key=lambda item: (-item[1], item[0]))
        if times >= params.least_scans
    ]
