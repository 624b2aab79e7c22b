"""The final track of a session: every second told by everything before and after it.

The fold runs once more over all observations and leaves its evidence (`SessionState.evidence`);
floors are decided forward and backward. Two smoothers draw the path, and the track lies between
them: particles from both ends (`app.core.fusion.both_ways`), and a Kalman smoother that begins
with the path of those (`app.core.fusion.smoother`). One knows ways and keeps several places alive,
the other keeps one bias and one step length over the whole walk, and they err apart.

A second between two strides is placed on the way from one to the other.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from app.core.engine.fixing import leaked, trusted
from app.core.engine.pipeline import advance, end
from app.core.engine.report import calibrated, radius95_m
from app.core.engine.standing import ground_of
from app.core.engine.state import SessionState, start
from app.core.fusion.both_ways import follow_both_ways
from app.core.fusion.ground import Ground
from app.core.fusion.sighting import Noise
from app.core.fusion.smoother import Leg, Path, smooth
from app.core.params import FusionParams, Params, ReportParams, SmootherParams
from app.core.site import SiteModel
from app.core.types import FloatArray, Method, Observation, Output, TrackPoint, Used

STRIDE_S = 1.0
"""A stride takes no longer (slow walkers: 1 Hz): who takes one after a rest stood until then."""


@dataclass(slots=True)
class _History:
    """What the fold left: legs of the path, and of each sighting the floor belief after it.

    ``shared_m2`` is the variance per axis in which it errs as its neighbours do: that of a scan's
    candidates about the truth, and none of what anchors told, whose R is not of that kind.
    """

    legs: list[Leg] = field(default_factory=list)
    beliefs: list[FloatArray] = field(default_factory=list)
    shared_m2: list[float] = field(default_factory=list)


def smoothed(
    observations: Iterable[Observation], site: SiteModel, params: Params
) -> tuple[TrackPoint, ...]:
    """Return the final track of a session.

    Parameters
    ----------
    observations
        All of them, in the order of `order_key`, each once.

    Returns
    -------
    tuple of TrackPoint
        At the seconds, and the end, at which the causal track has a point, and at those before its
        first one that what came later tells; that track itself where the profile has no smoother.
    """
    state, history = start(), _History()
    outputs: list[Output] = []
    for observation in observations:
        state, new = advance(state, observation, site, params)
        _remember(history, state, observation.time_s)
        outputs.extend(new)
    state, last = end(state, site, params)
    _remember(history, state, math.inf)
    outputs.extend(last)
    points = [output for output in outputs if isinstance(output, TrackPoint)]
    if params.smoother is None or not points:
        return tuple(points)
    points = _beginning(outputs, points[0], params.report) + points
    return _placed(points, history, (site, params), params.smoother)


def _remember(history: _History, state: SessionState, time_s: float) -> None:
    evidence = state.evidence
    legs = [
        Leg(s.time_s, np.array([s.length_m]), np.array([s.heading_rad]), 0.0, None, None)
        for s in evidence.strides
    ]
    if evidence.sighting is not None and state.floor_belief is not None:
        none = np.empty(0)
        legs.append(Leg(time_s, none, none, evidence.drift_m2, evidence.sighting, None))
        history.beliefs.append(state.floor_belief)
        xx, _, yy = evidence.sighting.noise_m2
        laterated = evidence.means is Method.LATERATION
        history.shared_m2.append(0.0 if laterated else 0.5 * (xx + yy))
    history.legs.extend(legs)


def _beginning(outputs: list[Output], first: TrackPoint, report: ReportParams) -> list[TrackPoint]:
    """Return points for the seconds before the first fix: no longer than one told a place after it.

    A causal track has none there, since nothing had told the place yet.
    """
    begin_s = first.time_s - report.fused_s
    return [
        replace(
            first,
            time_s=output.time_s,
            speed_mps=0.0,
            heading_rad=None,
            method=Method.DEAD_RECKONING,
            used=Used(),
            age_s=first.time_s - output.time_s,
        )
        for output in outputs
        if begin_s <= output.time_s < first.time_s
    ]


def _placed(
    points: list[TrackPoint],
    history: _History,
    world: tuple[SiteModel, Params],
    smoother: SmootherParams,
) -> tuple[TrackPoint, ...]:
    site, params = world
    floors = _smoothed_floors(history, params)
    ordered = _in_order(history.legs)
    sighted = np.cumsum([leg.sighting is not None for leg in ordered]).tolist()
    # Strides before the first sighting are on its floor.
    of_sighting = [max(count - 1, 0) for count in sighted]
    floor_of = [floors[i] for i in of_sighting]
    legs = [
        replace(leg, walkable=site.floors[int(np.argmax(belief))].walkable)
        for leg, belief in zip(ordered, floor_of, strict=True)
    ]
    path = _path(legs, [ground_of(belief, site) for belief in floor_of], params.fusion, smoother)
    times = [leg.time_s for leg in legs]
    told_s = next(leg.time_s for leg in legs if leg.sighting is not None)
    placed = []
    for point, place in zip(points, _on_the_way(points, legs, path), strict=True):
        at = max(bisect_right(times, point.time_s) - 1, 0)
        unseen_m2 = params.fusion.unseen_m2ps * max(told_s - point.time_s, 0.0)
        covariance = path.covariance[at] + unseen_m2 * np.eye(2)
        shared_m2 = smoother.sighted_share * history.shared_m2[of_sighting[at]]
        extra_m2 = smoother.extra_variance_m2 + shared_m2
        spread = calibrated(covariance, smoother.covariance_scale, extra_m2)
        moved = _moved(point, place, spread)
        placed.append(_on_floor(moved, floor_of[at], site))
    return tuple(placed)


def _in_order(legs: list[Leg]) -> list[Leg]:
    """Return legs by their time: a pedometer tells strides after scans that were made among them.

    At equal times strides come first, as in the fold.
    """
    return sorted(legs, key=lambda leg: (leg.time_s, leg.sighting is not None))


def _on_the_way(points: list[TrackPoint], legs: list[Leg], path: Path) -> FloatArray:
    """Return the place of each point (n, 2): its leg's, and what was done of the next stride."""
    times = [leg.time_s for leg in legs]
    strides = [i for i, leg in enumerate(legs) if i and len(leg.length_m)]
    ends_s = [times[i] for i in strides]
    places = np.empty((len(points), 2))
    for row, point in enumerate(points):
        places[row] = path.place[max(bisect_right(times, point.time_s) - 1, 0)]
        after = bisect_right(ends_s, point.time_s)
        if after < len(strides):
            i, end_s = strides[after], ends_s[after]
            begin_s = max([end_s - STRIDE_S, *ends_s[max(after - 1, 0) : after]])
            done = max(point.time_s - begin_s, 0.0) / (end_s - begin_s)
            places[row] += done * (path.place[i] - path.place[i - 1])
    return places


def _path(
    legs: list[Leg], floors: list[Ground], fusion: FusionParams, smoother: SmootherParams
) -> Path:
    believed = replace(fusion, tempering=smoother.tempering, way_weight=smoother.way_weight)
    both_ways = follow_both_ways(legs, floors, believed)
    kalman = smooth(legs, both_ways, smoother)
    share = smoother.both_ways_share
    return Path(share * both_ways.place + (1.0 - share) * kalman.place, kalman.covariance)


def _smoothed_floors(history: _History, params: Params) -> list[FloatArray]:
    """Return the probability of each floor at each sighting, by the forward-backward algorithm."""
    sightings = [leg.sighting for leg in history.legs if leg.sighting is not None]
    out = list(history.beliefs)
    backward = np.ones_like(out[-1])
    for i in range(len(out) - 2, -1, -1):
        later = sightings[i + 1]
        elapsed_s = later.time_s - sightings[i].time_s
        backward = leaked(backward * trusted(later.floor_votes, params), elapsed_s, params)
        backward /= backward.sum()
        out[i] = history.beliefs[i] * backward
        out[i] /= out[i].sum()
    return out


def _moved(point: TrackPoint, place: FloatArray, spread: Noise) -> TrackPoint:
    xx, xy, yy = spread
    return replace(
        point,
        x_m=float(place[0]),
        y_m=float(place[1]),
        covariance_m2=(xx, xy, yy),
        radius95_m=radius95_m(xx, xy, yy),
    )


def _on_floor(point: TrackPoint, belief: FloatArray, site: SiteModel) -> TrackPoint:
    floor = int(np.argmax(belief))
    return replace(
        point, floor_id=site.floors[floor].floor_id, floor_confidence=float(belief[floor])
    )
