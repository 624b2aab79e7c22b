"""Why the latest fix is what it is, from what the session's state remembers; made on demand."""

from statistics import median

import numpy as np

from app.core.engine.explanation import (
    BlamedAnchor,
    CandidatePlace,
    Explanation,
    FloorVote,
    Gate,
    MotionReason,
    Residual,
    Use,
)
from app.core.engine.pipeline import end
from app.core.engine.profiles import PROFILES
from app.core.engine.residuals import residuals_of
from app.core.engine.standing import ground_of
from app.core.engine.state import SessionState, Told
from app.core.engine.walking import stay
from app.core.fusion.innovation import (
    Innovation,
    innovation_of_particles,
    innovation_of_planar,
)
from app.core.fusion.particles import Particles, diffuse
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.sighting import Sighting
from app.core.motion.mode import MotionState, decided, deciding
from app.core.params import MotionModeParams, Params
from app.core.site import SiteModel


def explained(state: SessionState, site: SiteModel, params: Params) -> Explanation | None:
    """Return why the output at the latest observation is what it is; None before the first."""
    state, outputs = end(state, site, params)
    if not outputs:
        return None
    output, told = outputs[-1], state.told
    motion = _motion(state.motion, output.time_s, params.motion_mode)
    sighting = None if told is None else told.evidence.sighting
    floors = _floors(state, sighting, site)
    if told is None:
        return Explanation(output, None, None, (), (), None, None, floors, motion)
    innovation = _innovation(told, site, params)
    gate = None
    if innovation is not None:
        gate = Gate(innovation.distance_m, innovation.nis, innovation.inlier_probability)
    transmitters = residuals_of(state, told, site, params)
    return Explanation(
        output=output,
        means=told.means,
        scan_s=told.scan.time_s,
        candidates=_candidates(sighting, innovation, site),
        transmitters=transmitters,
        level_offset_db=_offset_db(transmitters),
        gate=gate,
        floors=floors,
        motion=motion,
        faults=tuple(BlamedAnchor(*each) for each in told.evidence.left_out.items()),
    )


def _innovation(told: Told, site: SiteModel, params: Params) -> Innovation | None:
    sighting, drift_m2 = told.evidence.sighting, told.evidence.drift_m2
    if sighting is None or told.before is None or PROFILES[params.profile].stride is stay:
        # A profile whose strides move nothing has no filter, and so no prediction.
        return None
    if isinstance(told.before, Particles):
        predicted = diffuse(told.before, drift_m2, ground_of(None, site))
        return innovation_of_particles(predicted, sighting, params.fusion)
    return innovation_of_planar(_widened(told.before, drift_m2), sighting)


def _widened(track: PlanarTrack, drift_m2: float) -> PlanarTrack:
    covariance = track.covariance.copy()
    covariance[:2, :2] += drift_m2 * np.eye(2)
    return PlanarTrack(track.mean, covariance)


def _candidates(
    sighting: Sighting | None, innovation: Innovation | None, site: SiteModel
) -> tuple[CandidatePlace, ...]:
    if sighting is None:
        return ()
    seen = sighting.weight if innovation is None else innovation.seen_weight
    voted = np.full(len(sighting.weight), np.argmax(sighting.floor_votes))
    floors = voted if sighting.floor_index is None else sighting.floor_index
    order = np.lexsort((-sighting.weight, -seen))
    return tuple(
        CandidatePlace(
            floor_id=site.floors[floors[i]].floor_id,
            x_m=float(sighting.places[i, 0]),
            y_m=float(sighting.places[i, 1]),
            weight=float(sighting.weight[i]),
            seen_weight=float(seen[i]),
        )
        for i in order
    )


def _floors(
    state: SessionState, sighting: Sighting | None, site: SiteModel
) -> tuple[FloorVote, ...]:
    votes, belief = None, state.floor_belief
    if sighting is not None:
        votes = sighting.floor_votes / sighting.floor_votes.sum()
    return tuple(
        FloorVote(
            floor_id=floor.floor_id,
            vote_share=None if votes is None else float(votes[i]),
            probability=None if belief is None else float(belief[i]),
        )
        for i, floor in enumerate(site.floors)
    )


def _motion(state: MotionState, time_s: float, params: MotionModeParams) -> MotionReason:
    return MotionReason(
        mode=decided(state, time_s, params).mode,
        decided_by=deciding(state, time_s, params),
        since_step_s=None if state.last_step_s is None else time_s - state.last_step_s,
        acc_variance_m2ps4=None if state.acc_s is None else state.acc_variance_m2ps4,
        velocity_chi2=None if state.velocity_s is None else state.velocity_chi2,
    )


def _offset_db(transmitters: tuple[Residual, ...]) -> float | None:
    used = [r.residual_db for r in transmitters if r.use is Use.USED and r.residual_db is not None]
    return median(used) if used else None
