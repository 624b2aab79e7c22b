"""The Gaussian-sum filter: filterpy agrees on one component, and its laws hold."""

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from app.core.fusion.mixture import Mixture, begin, diffuse, moments, update, walk
from app.core.params import FusionParams

PARAMS = FusionParams()
# One component, no Student weight, no births: what is left is the textbook filter.
PLAIN = dataclasses.replace(
    PARAMS, components=1, birth_share=0.0, merge_distance=1e9, student_dof=1e12
)
ONE = np.array([[12.0, 7.0]])


def started(params=PLAIN, variance=9.0):
    return begin(ONE, np.ones(1), (variance, 0.0, variance), params)


def test_one_component_is_the_extended_kalman_filter():
    mixture = walk(started(), 0.7, 0.4, PLAIN)
    noise = (4.0, 1.0, 6.0)
    ours = update(mixture, np.array([[14.0, 6.5]]), np.ones(1), noise, PLAIN)
    oracle = ExtendedKalmanFilter(dim_x=4, dim_z=2)
    oracle.x, oracle.P = mixture.mean[0].copy(), mixture.covariance[0].copy()
    oracle.R = np.array([[4.0, 1.0], [1.0, 6.0]])
    oracle.update(np.array([14.0, 6.5]), lambda x: np.eye(2, 4), lambda x: x[:2])
    assert np.allclose(ours.mean[0], oracle.x, atol=1e-9)
    assert np.allclose(ours.covariance[0], oracle.P, atol=1e-9)


def test_a_step_moves_and_widens_as_its_jacobian_says():
    mixture = started()
    moved = walk(mixture, 0.7, 0.4, PLAIN)

    def step(state):
        length = 0.7 * np.exp(state[3])
        turn = 0.4 + state[2]
        return state + np.array([length * np.cos(turn), length * np.sin(turn), 0.0, 0.0])

    mean = mixture.mean[0]
    assert np.allclose(moved.mean[0], step(mean))
    jacobian = np.column_stack([(step(mean + h) - step(mean - h)) / 2e-6 for h in 1e-6 * np.eye(4)])
    grown = jacobian @ mixture.covariance[0] @ jacobian.T
    added = moved.covariance[0] - grown
    assert np.allclose(added, added.T, atol=1e-9)
    assert np.linalg.eigvalsh(added).min() > -1e-9


def test_a_step_of_unknown_direction_only_widens():
    moved = walk(started(), 0.7, float("nan"), PLAIN)
    assert np.array_equal(moved.mean, started().mean)
    assert moved.covariance[0, 0, 0] == pytest.approx(9.0 + 0.5 * 0.49)


def test_two_far_places_stay_two_until_a_scan_decides():
    places = np.array([[0.0, 0.0], [60.0, 0.0]])
    mixture = begin(places, np.array([0.55, 0.45]), (16.0, 0.0, 16.0), PARAMS)
    assert len(mixture.weight) == 2
    near_second = np.array([[59.0, 1.0], [61.0, -1.0]])
    for _ in range(4):
        mixture = update(mixture, near_second, np.array([0.5, 0.5]), (16.0, 0.0, 16.0), PARAMS)
    assert moments(mixture)[0][:2] == pytest.approx([60.0, 0.0], abs=4.0)


def test_a_far_fix_pulls_little():
    settled = started(variance=1.0)
    far = update(settled, np.array([[52.0, 7.0]]), np.ones(1), (9.0, 0.0, 9.0), PARAMS)
    plain = update(settled, np.array([[52.0, 7.0]]), np.ones(1), (9.0, 0.0, 9.0), PLAIN)
    assert moments(far)[0][0] < moments(plain)[0][0]


def turned(mixture: Mixture, angle: float, shift: np.ndarray) -> Mixture:
    rotation = np.eye(4)
    rotation[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    mean = mixture.mean @ rotation.T
    mean[:, :2] += shift
    return Mixture(mean, rotation @ mixture.covariance @ rotation.T, mixture.weight)


@pytest.mark.parametrize("seed", range(5))
def test_translation_and_rotation_carry_the_track_along(seed):
    rng = np.random.default_rng(seed)
    angle, shift = rng.uniform(-3, 3), rng.uniform(-500, 500, 2)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    noise = np.array([[14.0, 0.0], [0.0, 14.0]])
    here = there = None
    for _ in range(6):
        places = rng.uniform(0, 40, (8, 2))
        weight = rng.dirichlet(np.ones(8))
        moved = places @ rotation.T + shift
        args = (weight, (noise[0, 0], 0.0, noise[1, 1]), PARAMS)
        here = begin(places, *args) if here is None else update(here, places, *args)
        there = begin(moved, *args) if there is None else update(there, moved, *args)
        heading = rng.uniform(-3, 3)
        here = walk(here, 0.7, heading, PARAMS)
        there = walk(there, 0.7, heading + angle, PARAMS)
    expected = turned(here, angle, shift)
    assert np.allclose(there.mean, expected.mean, atol=1e-6)
    assert np.allclose(there.covariance, expected.covariance, atol=1e-6)


def test_candidates_may_come_in_any_order():
    rng = np.random.default_rng(1)
    places, weight = rng.uniform(0, 40, (10, 2)), rng.dirichlet(np.ones(10))
    order = rng.permutation(10)
    noise = (10.0, 0.0, 10.0)
    one = update(begin(places, weight, noise, PARAMS), places, weight, noise, PARAMS)
    args = (places[order], weight[order], noise, PARAMS)
    other = update(begin(*args), *args)
    assert np.allclose(moments(one)[0], moments(other)[0], atol=1e-9)
    assert np.allclose(moments(one)[1], moments(other)[1], atol=1e-9)


def test_weights_sum_to_one_covariances_are_positive_inputs_untouched():
    rng = np.random.default_rng(2)
    mixture = begin(rng.uniform(0, 40, (6, 2)), np.full(6, 1 / 6), (9.0, 0.0, 9.0), PARAMS)
    for _ in range(30):
        kept = (mixture.mean.copy(), mixture.covariance.copy(), mixture.weight.copy())
        later = walk(mixture, 0.7, rng.uniform(-3, 3), PARAMS)
        places, weight = rng.uniform(0, 40, (5, 2)), rng.dirichlet(np.ones(5))
        later = update(diffuse(later, 0.1), places, weight, (9.0, 0.0, 9.0), PARAMS)
        assert np.array_equal(mixture.mean, kept[0])
        assert np.array_equal(mixture.covariance, kept[1])
        assert np.array_equal(mixture.weight, kept[2])
        assert later.weight.sum() == pytest.approx(1.0)
        assert len(later.weight) <= PARAMS.components
        for covariance in later.covariance:
            assert np.allclose(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance).min() > 0.0
        mixture = later
