"""The particle filter: it agrees with the Kalman filter where that is exact, and its laws hold."""

import dataclasses
import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from app.core.fusion.draws import normal, uniform
from app.core.fusion.ground import ground
from app.core.fusion.particles import (
    Particles,
    begin,
    diffuse,
    moments,
    update,
    walk,
    weights,
)
from app.core.fusion.sighting import Sighting
from app.core.geometry import Walkable
from app.core.params import FusionParams

PARAMS = FusionParams()
# Many particles and nothing that a Kalman filter does not have.
PLAIN = dataclasses.replace(
    PARAMS, particles=20_000, birth_share=0.0, clutter=0.0, tempering=1.0, jitter_share=0.0
)
OPEN = ground(None, (1.0, 0.0))


def seen(*places, variance=9.0, noise=None, weight=None):
    weight = np.full(len(places), 1.0 / len(places)) if weight is None else np.asarray(weight)
    noise = noise or (variance, 0.0, variance)
    return Sighting(0.0, np.array(places, dtype=np.float64), weight, noise, np.ones(1))


def test_draws_are_uniform_and_nearly_normal():
    numbers = range(40_000)
    flat = np.array([uniform(n) for n in numbers])
    bell = np.array([normal(n) for n in numbers])
    assert 0.0 <= flat.min() < flat.max() < 1.0
    assert np.histogram(flat, 10, (0.0, 1.0))[0] == pytest.approx(np.full(10, 4000), abs=250)
    assert bell.mean() == pytest.approx(0.0, abs=0.02)
    assert bell.std() == pytest.approx(1.0, abs=0.01)
    assert np.mean(np.abs(bell) < 1.96) == pytest.approx(0.95, abs=0.006)
    assert abs(np.corrcoef(bell[:-1], bell[1:])[0, 1]) < 0.02


def test_it_agrees_with_the_kalman_filter_on_a_linear_walk():
    particles = begin(seen((10.0, 5.0), noise=(9.0, 2.0, 6.0)), OPEN, PLAIN)
    oracle = KalmanFilter(dim_x=2, dim_z=2)
    oracle.x, oracle.P = np.array([10.0, 5.0]), np.array([[9.0, 2.0], [2.0, 6.0]])
    oracle.F, oracle.H, oracle.Q = np.eye(2), np.eye(2), np.eye(2) * 1.5
    oracle.R = np.array([[4.0, -1.0], [-1.0, 8.0]])
    for place in ((11.0, 7.0), (12.5, 4.0), (9.0, 6.0)):
        particles = update(
            diffuse(particles, 1.5, OPEN), seen(place, noise=(4.0, -1.0, 8.0)), OPEN, PLAIN
        )
        oracle.predict()
        oracle.update(np.array(place))
    mean, covariance = moments(particles)
    np.testing.assert_allclose(mean[:2], oracle.x, atol=0.1)
    np.testing.assert_allclose(covariance, oracle.P, atol=0.25)


def test_a_step_goes_where_the_phone_points_turned_by_the_bias():
    particles = begin(seen((0.0, 0.0), variance=1e-6), OPEN, PLAIN)
    moved = moments(walk(particles, (0.7, 0.4), OPEN, PLAIN))[0]
    shrunk = math.exp(-0.5 * (PLAIN.bias_prior_rad**2 + PLAIN.heading_noise_rad**2))
    assert moved[0] == pytest.approx(0.7 * math.cos(0.4) * shrunk, abs=0.01)
    assert moved[1] == pytest.approx(0.7 * math.sin(0.4) * shrunk, abs=0.01)


def test_a_step_of_unknown_direction_only_widens():
    particles = begin(seen((3.0, 4.0), variance=1.0), OPEN, PLAIN)
    mean, covariance = moments(walk(particles, (2.0, math.nan), OPEN, PLAIN))
    np.testing.assert_allclose(mean[:2], (3.0, 4.0), atol=0.05)
    assert np.trace(covariance) == pytest.approx(2.0 + 4.0, rel=0.05)


def test_two_far_places_stay_two_until_a_scan_decides():
    particles = begin(seen((0.0, 0.0), (60.0, 0.0)), OPEN, PARAMS)
    left = weights(particles) @ (particles.state[:, 0] < 30.0)
    assert left == pytest.approx(0.5, abs=0.02)
    for _ in range(4):
        particles = update(particles, seen((60.0, 0.0)), OPEN, PARAMS)
    np.testing.assert_allclose(moments(particles)[0][:2], (60.0, 0.0), atol=2.0)


def test_births_find_a_place_that_was_ruled_out():
    particles = begin(seen((0.0, 0.0)), OPEN, PARAMS)
    for _ in range(12):
        particles = update(particles, seen((200.0, 100.0)), OPEN, PARAMS)
    np.testing.assert_allclose(moments(particles)[0][:2], (200.0, 100.0), atol=3.0)


def test_walls_between_corridors_keep_particles_in_theirs():
    y = np.arange(-20, 21) * 0.5
    corridor = Walkable(-20.0, -10.0, 0.5, np.tile(np.maximum(np.abs(y) - 1.0, 0.0)[:, None], 121))
    floor = ground(corridor, (1.0, 0.0))
    inside = begin(seen((0.0, 0.0), variance=4.0), floor, PARAMS)
    free = begin(seen((0.0, 0.0), variance=4.0), OPEN, PARAMS)
    for _ in range(10):
        inside = walk(inside, (0.7, 0.3), floor, PARAMS)
        free = walk(free, (0.7, 0.3), OPEN, PARAMS)
    assert moments(free)[0][1] > 1.6
    assert abs(moments(inside)[0][1]) < 1.2


def test_the_bias_is_learned_from_where_steps_and_scans_lead():
    particles = begin(seen((0.0, 0.0), variance=1.0), OPEN, PARAMS)
    place = np.zeros(2)
    for _ in range(30):
        particles = walk(particles, (0.7, 0.0), OPEN, PARAMS)
        place += 0.7 * np.array([math.cos(0.4), math.sin(0.4)])
        particles = update(particles, seen(place, variance=1.0), OPEN, PARAMS)
    assert moments(particles)[0][2] == pytest.approx(0.4, abs=0.12)


def test_inputs_stay_as_they_are_and_the_same_comes_out_again():
    particles = begin(seen((1.0, 2.0), (4.0, 2.0)), OPEN, PARAMS)
    state, log_weight = particles.state.copy(), particles.log_weight.copy()

    def onward():
        walked = walk(particles, (0.7, 1.0), OPEN, PARAMS)
        return update(diffuse(walked, 0.5, OPEN), seen((2.0, 3.0)), OPEN, PARAMS)

    first, second = onward(), onward()
    assert np.array_equal(particles.state, state)
    assert np.array_equal(particles.log_weight, log_weight)
    assert np.array_equal(first.state, second.state)
    assert first.counter == second.counter > particles.counter


def test_no_draw_is_taken_twice():
    one = begin(seen((0.0, 0.0)), OPEN, PARAMS)
    first = walk(one, (0.7, 0.0), OPEN, PARAMS)
    again = walk(Particles(one.state, one.log_weight, first.counter), (0.7, 0.0), OPEN, PARAMS)
    apart = (first.state - one.state)[:, 2], (again.state - one.state)[:, 2]
    assert abs(np.corrcoef(*apart)[0, 1]) < 0.2
    assert np.abs(apart[0]).min() < np.abs(apart[0] - apart[1]).max()
