"""The constant-velocity filter against filterpy, and what it promises of a walker."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from app.core.fusion.constant_velocity import begun_at, moved_on, with_place, with_velocity

WALK_MPS = 0.7


def oracle(place: np.ndarray) -> KalmanFilter:
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.x = np.array([*place, 0.0, 0.0])
    kalman.P = np.diag([4.0, 4.0, 1.0, 1.0])
    return kalman


def predicted(kalman: KalmanFilter, seconds: float) -> None:
    transition = np.eye(4)
    transition[0, 2] = transition[1, 3] = seconds
    block = Q_continuous_white_noise(2, seconds, WALK_MPS**2)
    kalman.predict(F=transition, Q=np.kron(block, np.eye(2)))


def test_it_is_filterpys_filter_on_a_long_walk() -> None:
    rng = np.random.default_rng(1)
    start = np.array([3.0, -2.0])
    ours, theirs = begun_at(start, 2.0, 1.0), oracle(start)
    for _ in range(200):
        seconds, place, velocity = rng.uniform(0.0, 3.0), rng.normal(0, 9, 2), rng.normal(0, 1, 2)
        ours = moved_on(ours, seconds, WALK_MPS)
        predicted(theirs, seconds)
        ours = with_velocity(ours, tuple(velocity), 0.6)
        theirs.update(velocity, R=0.36, H=np.eye(4)[2:])
        ours = with_place(ours, place, 5.0)
        theirs.update(place, R=25.0, H=np.eye(4)[:2])
        np.testing.assert_allclose(ours.mean, theirs.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.P, rtol=1e-9, atol=1e-9)


@given(st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_two_short_predictions_are_one_long_one(first_s: float, second_s: float) -> None:
    track = with_velocity(begun_at(np.array([1.0, 2.0]), 2.0, 1.0), (1.0, -0.5), 0.3)
    once = moved_on(track, first_s + second_s, WALK_MPS)
    twice = moved_on(moved_on(track, first_s, WALK_MPS), second_s, WALK_MPS)
    np.testing.assert_allclose(once.mean, twice.mean, atol=1e-9)
    np.testing.assert_allclose(once.covariance, twice.covariance, rtol=1e-9, atol=1e-9)


def test_it_learns_a_velocity_that_nobody_measured() -> None:
    track = begun_at(np.zeros(2), 2.0, 2.0)
    for second in range(1, 60):
        track = moved_on(track, 1.0, 0.01)
        track = with_place(track, np.array([1.2 * second, 0.0]), 1.0)
    assert track.mean[2:] == pytest.approx([1.2, 0.0], abs=0.02)


def test_the_filter_it_came_from_is_left_as_it_was() -> None:
    track = begun_at(np.zeros(2), 2.0, 1.0)
    mean, covariance = track.mean.copy(), track.covariance.copy()
    with_place(with_velocity(moved_on(track, 1.0, WALK_MPS), (1.0, 1.0), 0.3), np.ones(2), 1.0)
    np.testing.assert_array_equal(track.mean, mean)
    np.testing.assert_array_equal(track.covariance, covariance)
