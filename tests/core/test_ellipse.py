"""The ellipse of a covariance: its axes, their direction, and what it holds."""

import math

import numpy as np
import pytest

from app.core.geometry import ellipse95


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 150.0])
def test_a_turned_covariance_has_turned_axes(degrees: float) -> None:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = np.array([[c, -s], [s, c]])
    covariance = turn @ np.diag([9.0, 1.0]) @ turn.T
    ellipse = ellipse95((covariance[0, 0], covariance[0, 1], covariance[1, 1]))
    assert (ellipse.major_m, ellipse.minor_m) == pytest.approx((7.343, 2.448), abs=1e-3)
    assert math.degrees(ellipse.direction_rad) == pytest.approx(degrees)


def test_it_holds_95_of_100_places() -> None:
    places = np.random.default_rng(3).multivariate_normal((0, 0), [[4, 1], [1, 2]], 20_000)
    ellipse = ellipse95((4.0, 1.0, 2.0))
    c, s = math.cos(ellipse.direction_rad), math.sin(ellipse.direction_rad)
    inside = np.hypot(places @ (c, s) / ellipse.major_m, places @ (-s, c) / ellipse.minor_m) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.01)
