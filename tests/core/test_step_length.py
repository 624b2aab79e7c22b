"""Step length from acceleration swings: the trained walk is right, lengths scale as they say."""

import numpy as np
import pytest

from app.core.motion.step_length import step_lengths_m, swing_root, trained_gain


def test_a_trained_walk_is_as_long_as_it_was():
    rng = np.random.default_rng(1)
    root = swing_root(rng.uniform(2.0, 5.0, 40), rng.uniform(4.0, 9.0, 40))
    assert step_lengths_m(root, trained_gain(root, 27.0)).sum() == pytest.approx(27.0)


def test_length_goes_with_the_fourth_root_of_both_swings():
    few = swing_root(np.array([2.0]), np.array([8.0]))
    assert few == pytest.approx([2.0])
    assert swing_root(np.array([4.0]), np.array([64.0])) == pytest.approx(2.0 * few)


def test_a_walk_without_swings_trains_nothing():
    with pytest.raises(ValueError, match="no step"):
        trained_gain(np.zeros(5), 10.0)
