"""Voting among reference points: who has the most votes, and who wins a tie."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.core.fingerprint.cells import CellParams, cell_map
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.voting import VotingParams, heard_columns, hold_ballot

PARAMS = VotingParams(within_db=5.0, min_votes=1)
CELLS = CellParams(cell_m=3.0)


def asked(rows, levels_dbm, params=PARAMS):
    """Return the x index of the winning cell; rows are levels of cells 0, 1, 2, ... along x."""
    fingerprints = [Fingerprint(0, 3.0 * i + 1.5, 1.5, row, {}, "w") for i, row in enumerate(rows)]
    radio_map = build_radio_map(("f",), fingerprints)
    heard = heard_columns(Query(levels_dbm, {}), radio_map)
    return hold_ballot(*heard, cell_map(radio_map, CELLS), params).winner(params.min_votes)


def test_most_agreeing_transmitters_win_over_the_nearest_levels():
    near_but_one = {"w:a": -50.0, "w:b": -60.0, "w:c": -90.0}
    all_within = {"w:a": -55.0, "w:b": -65.0, "w:c": -75.0}
    assert asked([near_but_one, all_within], {"w:a": -50.0, "w:b": -60.0, "w:c": -70.0}) == 1


def test_a_difference_of_exactly_x_has_the_vote_and_a_larger_one_has_not():
    assert asked([{"w:a": -55.0}], {"w:a": -50.0}) == 0
    assert asked([{"w:a": -55.01}], {"w:a": -50.0}) is None


def test_among_equals_the_cell_wins_that_expected_the_fewest_others():
    rich = {"w:a": -50.0, "w:b": -60.0, "w:c": -70.0}
    assert asked([rich, {"w:a": -53.0}], {"w:a": -50.0}) == 1


def test_among_equals_in_that_too_the_least_misfit_wins_then_the_first():
    assert asked([{"w:a": -53.0}, {"w:a": -51.0}], {"w:a": -50.0}) == 1
    assert asked([{"w:a": -51.0}, {"w:a": -49.0}], {"w:a": -50.0}) == 0


def test_too_few_votes_are_no_answer():
    few = VotingParams(within_db=5.0, min_votes=2)
    assert asked([{"w:a": -50.0, "w:b": -50.0}], {"w:a": -50.0, "w:b": -90.0}, few) is None
    assert asked([{"w:a": -50.0}], {"w:unknown": -50.0}) is None
    assert asked([], {"w:a": -50.0}) is None


levels = st.dictionaries(
    st.sampled_from([f"w:{i}" for i in range(8)]),
    st.floats(-95.0, -40.0).map(lambda level: round(level, 1)),
    min_size=1,
)


@settings(max_examples=60, deadline=None)
@given(st.lists(levels, min_size=1, max_size=6), levels, st.randoms(use_true_random=False))
def test_votes_are_counted_as_the_rule_says_in_any_order_of_readings(rows, query, random):
    shuffled = list(query.items())
    random.shuffle(shuffled)
    votes = [sum(k in row and abs(query[k] - row[k]) <= 5.0 for k in query) for row in rows]
    winner = asked(rows, dict(shuffled))
    if max(votes) == 0:
        assert winner is None
    else:
        assert votes[winner] == max(votes)
        assert winner == asked(rows, query)


def test_one_transmitter_that_moved_costs_one_vote():
    rng = np.random.default_rng(3)
    rows = [{f"w:{t}": float(-40 - rng.integers(50)) for t in range(10)} for _ in range(20)]
    for i, row in enumerate(rows):
        assert asked(rows, row | {"w:0": -120.0}) == pytest.approx(i)
