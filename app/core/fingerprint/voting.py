"""Voting: the reference point that most of the transmitters heard agree on.

Equation
--------
With ``u_t`` the level of transmitter t heard now and ``m_ct`` the mean level that the survey stored
at reference point c::

    votes_c  = #{t : |u_t - m_ct| <= X}
    misfit_c = sum of |u_t - m_ct| over those t
    winner   = the c with the most votes

Each transmitter has one vote per reference point whatever its level, so one that died or was moved
costs one vote and no more. Votes are whole, so ties happen (one scan in ten of ms2020's tuning
walks, nearly all where little is heard). Among equals the one that stored the fewest transmitters
wins: it expected the fewest that were not heard, of which the votes say nothing. Among equals in
that too the least misfit wins, then the first cell, so that an answer never depends on the order of
readings.

Source: Nguyen Ngoc Khuong, "BluNavi: an indoor positioning and navigation system", Haiphong
University Journal of Science 44, 2021.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from app.core.fingerprint.cells import CellMap
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import RadioMap
from app.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class VotingParams:
    """Parameters of the voting matcher.

    Attributes
    ----------
    within_db
        ``X`` above. A level at one place varies by 4 to 6 dB: much less and the true place misses
        its votes, much more and everywhere gets them. On ms2020's tuning walks the mean error is
        flat within 3 % from 6 to 10 dB.
    min_votes
        Fewer are no answer: one transmitter fits some cell of any map by chance.
    least_vote_share
        Nor is a smaller share of what is heard: outside the surveyed area most votes are missing.
    """

    within_db: float = 8.0
    min_votes: int = 2
    least_vote_share: float = 0.15

    def needed(self, heard: int) -> int:
        """Return the votes that a winner needs where so many transmitters are heard."""
        return max(self.min_votes, math.ceil(self.least_vote_share * heard))


@dataclass(frozen=True, slots=True, eq=False)
class Ballot:
    """What the transmitters of one scan said.

    Attributes
    ----------
    votes : (cells,)
        Transmitters whose level agrees with the cell's.
    misfit_db : (cells,)
        Sum of their absolute deviations.
    stored : (cells,)
        Transmitters that the survey heard in the cell.
    """

    votes: IntArray
    misfit_db: FloatArray
    stored: IntArray

    def winner(self, min_votes: int) -> int | None:
        """Return the cell with the most votes by the rule above, None with fewer than that."""
        if not len(self.votes) or self.votes.max() < min_votes:
            return None
        leading = np.flatnonzero(self.votes == self.votes.max())
        order = np.lexsort((self.misfit_db[leading], self.stored[leading]))
        return int(leading[order[0]])


def heard_columns(query: Query, radio_map: RadioMap) -> tuple[IntArray, FloatArray]:
    """Return what is heard as columns of the map and levels, by column.

    Transmitters that the map does not know are left out: the published rule has no use for them.
    """
    levels_dbm = {**query.wifi_dbm, **query.ble_dbm}
    known = sorted(
        (radio_map.column_by_key[key], level_dbm)
        for key, level_dbm in levels_dbm.items()
        if key in radio_map.column_by_key
    )
    column = np.array([each for each, _ in known], dtype=np.int64)
    return column, np.array([level_dbm for _, level_dbm in known], dtype=np.float64)


def hold_ballot(
    column: IntArray, rssi_dbm: FloatArray, cells: CellMap, params: VotingParams
) -> Ballot:
    """Return the votes of one scan.

    Parameters
    ----------
    column, rssi_dbm : (transmitters,)
        What is heard, as columns of the map (`heard_columns`).
    """
    votes, misfit_db = _count(
        column,
        rssi_dbm,
        (cells.column_start, cells.column_cell, cells.mean_dbm[cells.column_entry]),
        params.within_db,
        cells.cells,
    )
    return Ballot(votes, misfit_db, np.diff(cells.row_start))


@njit(cache=True)
def _count(
    column: IntArray,
    rssi_dbm: FloatArray,
    inverted: tuple[IntArray, IntArray, FloatArray],
    within_db: float,
    cells: int,
) -> tuple[IntArray, FloatArray]:  # pragma: no cover - compiled
    column_start, cell, mean_dbm = inverted
    votes = np.zeros(cells, np.int64)
    misfit_db = np.zeros(cells)
    for i in range(len(column)):
        for entry in range(column_start[column[i]], column_start[column[i] + 1]):
            apart_db = abs(rssi_dbm[i] - mean_dbm[entry])
            if apart_db <= within_db:
                votes[cell[entry]] += 1
                misfit_db[cell[entry]] += apart_db
    return votes, misfit_db
