"""Ageing: transmitters that a radio map knows and live traffic contradicts.

Nobody knows where live phones are, but each scan resembles some fingerprints (weights w_r), and
they say what ought to be heard there. With levels as shares a of what can be heard (0: silent),
transmitter t has over all scans s of the traffic the residual

    R_t = Σ_s |a_st - ē_st| / Σ_s (a_st + ē_st),   ē_st = Σ_r w_sr a_rt

(a Sørensen distance, 0 to 1). It is never 0, even of a fresh map, so it is compared with the map's
own: R0_t, of each surveyed scan matched without its own walk. Both lean on what is usual:

    R0_t = (off0_t + κ R) / (all0_t + κ),   R_t = (off_t + κ R0_t) / (all_t + κ)

R the residual of all transmitters together. One is suspect where R_t - R0_t exceeds ``excess``.
What is suspect misleads the matching of everything else, so traffic is then matched anew without
it, ``passes`` times. Residuals of moved transmitters stand out because the many others still say
where the phone is: with most of them moved there is nothing to find, and a new survey is due.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from app.core.fingerprint.leaving_out import is_surveyed, left_out_matches
from app.core.fingerprint.matching import Matches, match, represent
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import BLE, RadioMap
from app.core.params import MatchParams
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class AgeingParams:
    """When a transmitter is suspect.

    Chosen on ms2020 (folds 1 and 2 as traffic in turn, identities permuted).

    Attributes
    ----------
    exponent
        Of levels as shares; with the matcher's own only the nearest transmitters would count.
    lean
        κ: evidence (in shares) that weighs as much as what is usual. So large that a transmitter
        heard in a few scans only is never suspect.
    excess
        R_t - R0_t above which a transmitter is suspect.
    least_scans
        An unknown transmitter heard in fewer scans has not appeared, it passed by.
    vanished_share
        Heard less than this share of what is expected, a suspect has vanished; else it has moved.
    passes
        How often traffic is matched; the second time without what the first found.
    """

    exponent: float = 1.0
    lean: float = 16.0
    excess: float = 0.17
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
    residual, map_residual
        R_t and R0_t; of one that has appeared 1 and 0, for the map expects it nowhere.
    heard, expected
        Σ a and Σ ē over the scans of the traffic.
    scans
        In how many scans of the traffic it was heard.
    """

    key: str
    change: Change
    residual: float
    map_residual: float
    heard: float
    expected: float
    scans: int

    @property
    def excess(self) -> float:
        """How much worse traffic fits than the survey fits itself."""
        return self.residual - self.map_residual


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Sums over scans, by transmitter of the map (columns,)."""

    off: FloatArray
    heard: FloatArray
    expected: FloatArray
    scans: IntArray

    @property
    def total(self) -> FloatArray:
        """Σ (a + ē): how much evidence there is."""
        return self.heard + self.expected


def own_residuals(radio_map: RadioMap, matching: MatchParams, params: AgeingParams) -> Residuals:
    """Return the residuals of the survey against itself; they change with the map only."""
    surveyed = radio_map.of_rows(is_surveyed(radio_map))
    return residuals(left_out_matches(surveyed, matching), surveyed, matching, params)


def residuals(
    matched: Iterable[tuple[Query, Matches | None]],
    radio_map: RadioMap,
    matching: MatchParams,
    params: AgeingParams,
) -> Residuals:
    """Return what scans say of every transmitter; those that match nothing are passed over.

    Parameters
    ----------
    matched
        Scans and the rows of ``radio_map`` that they resemble.
    """
    columns = len(radio_map.transmitters)
    floor_dbm = _floors_dbm(radio_map, matching)
    share = represent(radio_map.rssi_dbm, floor_dbm[radio_map.column], params.exponent)
    off, heard, expected = (np.zeros(columns) for _ in range(3))
    scans = np.zeros(columns, dtype=np.int64)
    for query, matches in matched:
        if matches is None:
            continue
        here = _heard_share(query, radio_map, floor_dbm, params)
        there = _expected_share(matches, radio_map, share)
        off += np.abs(here - there)
        heard += here
        expected += there
        scans += here > 0.0
    return Residuals(off, heard, expected, scans)


def _floors_dbm(radio_map: RadioMap, matching: MatchParams) -> FloatArray:
    return np.where(radio_map.radio == BLE, matching.ble_floor_dbm, matching.wifi_floor_dbm)


def _heard_share(
    query: Query, radio_map: RadioMap, floor_dbm: FloatArray, params: AgeingParams
) -> FloatArray:
    share = np.zeros(len(radio_map.transmitters))
    known = [
        (radio_map.column_by_key[key], level_dbm)
        for levels in (query.wifi_dbm, query.ble_dbm)
        for key, level_dbm in levels.items()
        if key in radio_map.column_by_key
    ]
    if known:
        column = np.array([c for c, _ in known], dtype=np.int64)
        level_dbm = np.array([level for _, level in known], dtype=np.float64)
        share[column] = represent(level_dbm, floor_dbm[column], params.exponent)
    return share


def _expected_share(matches: Matches, radio_map: RadioMap, share: FloatArray) -> FloatArray:
    start, end = radio_map.row_start[matches.row], radio_map.row_start[matches.row + 1]
    entries = np.concatenate([np.arange(a, b) for a, b in zip(start, end, strict=True)])
    weight = np.repeat(matches.weight, end - start)
    columns = len(radio_map.transmitters)
    return np.bincount(radio_map.column[entries], weight * share[entries], columns).astype(
        np.float64
    )


def find_aged(
    traffic: Sequence[Query],
    radio_map: RadioMap,
    own: Residuals,
    matching: MatchParams,
    params: AgeingParams,
) -> list[Suspect]:
    """Return the transmitters that traffic contradicts, the worst first.

    Parameters
    ----------
    traffic
        Single scans, named as the map names transmitters (`first_of`).
    own
        The map's `own_residuals`.
    """
    suspects: list[Suspect] = []
    for _ in range(params.passes):
        left = radio_map.without_transmitters({suspect.key for suspect in suspects})
        # Rows are the same with and without suspects, so what the map says of those stays known.
        matched = ((query, match(query, left, matching)) for query in traffic)
        live = residuals(matched, radio_map, matching, params)
        suspects = _suspects(radio_map, live, own, params)
    return sorted(suspects, key=lambda s: (-s.excess, s.key))


def _suspects(
    radio_map: RadioMap, live: Residuals, own: Residuals, params: AgeingParams
) -> list[Suspect]:
    usual = own.off.sum() / max(float(own.total.sum()), 1e-9)
    map_residual = (own.off + params.lean * usual) / (own.total + params.lean)
    residual = (live.off + params.lean * map_residual) / (live.total + params.lean)
    aged = residual - map_residual > params.excess
    return [
        Suspect(
            key=radio_map.transmitters[t],
            change=_change(float(live.heard[t]), float(live.expected[t]), params),
            residual=float(residual[t]),
            map_residual=float(map_residual[t]),
            heard=float(live.heard[t]),
            expected=float(live.expected[t]),
            scans=int(live.scans[t]),
        )
        for t in np.flatnonzero(aged)
    ]


def _change(heard: float, expected: float, params: AgeingParams) -> Change:
    return Change.VANISHED if heard < params.vanished_share * expected else Change.MOVED


def appeared(
    traffic: Sequence[Query], radio_map: RadioMap, matching: MatchParams, params: AgeingParams
) -> list[Suspect]:
    """Return transmitters that the map does not know and traffic keeps hearing, loudest first."""
    heard: dict[str, tuple[float, int]] = {}
    for query in traffic:
        sides = (
            (query.wifi_dbm, matching.wifi_floor_dbm),
            (query.ble_dbm, matching.ble_floor_dbm),
        )
        for levels, floor_dbm in sides:
            for key, level_dbm in levels.items():
                if key not in radio_map.column_by_key:
                    total, scans = heard.get(key, (0.0, 0))
                    share = represent(np.array([level_dbm]), floor_dbm, params.exponent)
                    heard[key] = total + float(share[0]), scans + 1
    found = [
        Suspect(key, Change.APPEARED, 1.0, 0.0, total, 0.0, scans)
        for key, (total, scans) in heard.items()
        if scans >= params.least_scans
    ]
    return sorted(found, key=lambda s: (-s.heard, s.key))
