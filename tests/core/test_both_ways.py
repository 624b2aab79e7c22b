"""Particles from both ends of a walk: what comes later tells of what was, and laws hold."""

import dataclasses
import gc
import math

import numpy as np
import pytest

from app.core.fusion.both_ways import LEAST_VARIANCE_M2, follow_both_ways
from app.core.fusion.ground import ground
from app.core.fusion.particles import Particles, begin, moments
from app.core.fusion.sighting import Sighting
from app.core.fusion.smoother import Leg
from app.core.params import FusionParams

PARAMS = FusionParams()
OPEN = ground(None, (1.0, 0.0))
NONE = np.empty(0)
# Twelve steps to the north-east, 8.4 m.
HEADING_RAD = 0.25 * math.pi
WAY = 8.4 * np.array([math.cos(HEADING_RAD), math.sin(HEADING_RAD)])
SOUTH = np.array([0.0, -4.2])


def seen(time_s, *places, variance=4.0):
    weight = np.full(len(places), 1.0 / len(places))
    noise = (variance, 0.0, variance)
    one = Sighting(time_s, np.array(places, dtype=np.float64), weight, noise, np.ones(1))
    return Leg(time_s, NONE, NONE, 0.0, one, None)


def strides(time_s, count=12, heading_rad=HEADING_RAD):
    return Leg(time_s, np.full(count, 0.7), np.full(count, heading_rad), 0.0, None, None)


def follow(legs):
    return follow_both_ways(legs, [OPEN] * len(legs), PARAMS)


def test_the_end_of_a_walk_tells_where_it_began():
    far = (0.0, 30.0)
    ambiguous = seen(0.0, (0.0, 0.0), far)
    certain = [seen(6.0 + i, WAY) for i in range(4)]
    place = follow([ambiguous, strides(5.0), *certain]).place
    assert place[0] == pytest.approx([0.0, 0.0], abs=1.5)
    assert place[1] == pytest.approx(WAY, abs=1.0)
    alone = moments(begin(ambiguous.sighting, OPEN, PARAMS))[0]
    assert alone[1] == pytest.approx(15.0, abs=2.0)


def test_the_beginning_of_a_walk_tells_where_it_ended():
    far = WAY + np.array([0.0, 30.0])
    certain = [seen(float(i), (0.0, 0.0)) for i in range(4)]
    place = follow([*certain, strides(5.0), seen(6.0, WAY, far)]).place
    assert place[-1] == pytest.approx(WAY, abs=1.5)


def test_strides_before_the_first_sighting_are_walked_back():
    place = follow([strides(1.0, 2), strides(5.0), seen(6.0, WAY, variance=0.25)]).place
    assert place[0] == pytest.approx([0.0, 0.0], abs=1.5)
    assert place[1] == pytest.approx(WAY, abs=0.5)


def test_strides_after_the_last_sighting_are_walked_on():
    place = follow([seen(0.0, (0.0, 0.0), variance=0.25), strides(5.0)]).place
    assert place[-1] == pytest.approx(WAY, abs=1.5)


@pytest.mark.parametrize(("here", "there"), [(0, 2), (3, 4)], ids=["beginning", "end"])
def test_strides_of_one_filter_alone_go_on_from_the_place_that_both_tell(here, there):
    # Scans that contradict each other: at each end the filter that comes there is elsewhere.
    scans = [seen(2.0, (0.0, 0.0)), seen(3.0, (0.0, 30.0))]
    place = follow([strides(0.5, 2), strides(1.0, 2), *scans, strides(4.0, 2)]).place
    assert np.linalg.norm(place[there] - place[here]) == pytest.approx(1.4, abs=0.5)


def test_walked_the_other_way_round_it_is_the_same_path():
    walked = [
        seen(0.0, (0.0, 0.0)),
        strides(5.0),
        seen(6.0, WAY),
        strides(9.0, 6, -0.5 * math.pi),
        seen(10.0, WAY + SOUTH),
    ]
    turned = [
        seen(0.0, WAY + SOUTH),
        strides(1.0, 6, 0.5 * math.pi),
        seen(4.0, WAY),
        strides(5.0, 12, HEADING_RAD + math.pi),
        seen(10.0, (0.0, 0.0)),
    ]
    ahead, back = follow(walked), follow(turned)
    for here, there in ((0, 4), (2, 2), (4, 0)):
        assert ahead.place[here] == pytest.approx(back.place[there], abs=0.5)


def test_a_plan_that_is_moved_moves_the_path():
    legs = [seen(0.0, (0.0, 0.0), (3.0, 9.0)), strides(5.0), seen(6.0, WAY)]
    shift = np.array([120.0, -40.0])
    moved = [
        leg
        if leg.sighting is None
        else dataclasses.replace(
            leg, sighting=dataclasses.replace(leg.sighting, places=leg.sighting.places + shift)
        )
        for leg in legs
    ]
    here, there = follow(legs), follow(moved)
    np.testing.assert_allclose(there.place, here.place + shift, atol=1e-6)
    np.testing.assert_allclose(there.covariance, here.covariance, atol=1e-6)


def test_covariances_are_symmetric_positive_and_inputs_untouched():
    legs = [
        dataclasses.replace(seen(float(i), (i, 0.0), (0.0, 2.0 * i)), drift_m2=0.5)
        for i in range(8)
    ]
    before = [leg.sighting.places.copy() for leg in legs]
    covariance = follow(legs).covariance
    np.testing.assert_allclose(covariance, covariance.transpose(0, 2, 1), atol=1e-12)
    # Two that know the place all but exactly are still sure to within the least variance only.
    assert np.linalg.eigvalsh(covariance).min() > 0.49 * LEAST_VARIANCE_M2
    for leg, places in zip(legs, before, strict=True):
        np.testing.assert_array_equal(leg.sighting.places, places)


class CountsParticles(list):
    """Grounds that count, whenever one is asked for, the clouds of particles that are kept."""

    def __init__(self, grounds, kept):
        super().__init__(grounds)
        self.kept = kept

    def __iter__(self):
        for one in super().__iter__():
            self.kept.append(sum(isinstance(thing, Particles) for thing in gc.get_objects()))
            yield one

    def __getitem__(self, which):
        return CountsParticles(super().__getitem__(which), self.kept)


def test_a_long_walk_does_not_keep_the_particles_of_all_its_legs():
    legs = [seen(0.0, (0.0, 0.0)), *(strides(float(i), 1) for i in range(1, 15))]
    kept = []
    follow_both_ways(legs, CountsParticles([OPEN] * len(legs), kept), PARAMS)
    assert len(kept) == 2 * len(legs)
    assert max(kept) <= 2
