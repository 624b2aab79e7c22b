"""The map grows from use: sessions are placed by the map, and become part of what places others.

Where the survey left a hole no fingerprint resembles what a phone hears, and its track collapses on
the nearest surveyed place with a radius that knows nothing of it (on ms2020 the radius does not
rank the true error at all). What ranks it is how strange the session is to the map: the mean over
its scans of the Sørensen distance D1 to the nearest fingerprint. So the map grows outward, in
rounds: sessions that the map knows well become part of it, the others are placed again with them,
and those known well by then come next.

Sessions are dealt into groups, and each group is placed by the rows of the others, so that no
session is held where it is by its own rows.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from app.core.engine.order import order_key
from app.core.engine.pipeline import advance
from app.core.engine.smoothing import smoothed
from app.core.engine.state import Stride, start
from app.core.fingerprint.growth import GROWN, Candidate, GrowthParams, candidates
from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query, first_of
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, joined
from app.core.fingerprint.virtual import VirtualParams, filled, is_virtual
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import BleScan, Observation, Steps, WifiScan


@dataclass(frozen=True, slots=True)
class GrowingParams:
    """How the map grows.

    Attributes
    ----------
    max_mean_sorensen
        Of the sessions that join in each round.
    min_floor_share
        Mean weight, over its scans, of candidates on the floors that a session is placed on. A
        session that the map does not know is placed on a wrong floor as surely as on the right one,
        but its scans do not agree.
    groups
        Sessions are placed by the rows of those in other groups.
    rows
        Which scans of a session that joins become fingerprints.
    """

    max_mean_sorensen: tuple[float, ...] = (0.5, 0.6, 0.7)
    min_floor_share: float = 0.9
    groups: int = 3
    rows: GrowthParams = field(default_factory=GrowthParams)


@dataclass(frozen=True, slots=True)
class FinishedSession:
    """What a phone told in one session, in the order of the fold."""

    session_id: str
    observations: tuple[Observation, ...]


@dataclass(frozen=True, slots=True)
class GrownSession:
    """A session as the grown map places it, and how strange it is to that map (0 to 1)."""

    session_id: str
    candidates: tuple[Candidate, ...]
    mean_sorensen: float


def condensed(
    observations: Iterable[Observation], site: SiteModel, params: Params
) -> tuple[Observation, ...]:
    """Return a session without its raw inertial samples: steps, as found in them, in their place.

    It is placed alike, and may be kept where raw samples may not.
    """
    state = start()
    kept: list[Observation] = []
    for observation in observations:
        state, _ = advance(state, observation, site, params)
        if isinstance(observation, WifiScan | BleScan):
            kept.append(observation)
        kept += [_step(stride, site) for stride in state.evidence.strides]
    return tuple(sorted(kept, key=order_key))


def _step(stride: Stride, site: SiteModel) -> Steps:
    heading_rad = stride.heading_rad + site.x_axis_from_east_rad
    return Steps(
        stride.time_s, 1, stride.length_m, None if math.isnan(heading_rad) else heading_rad
    )


def grow(
    sessions: Sequence[FinishedSession], site: SiteModel, params: Params, growing: GrowingParams
) -> tuple[GrownSession, ...]:
    """Return the sessions that may become part of the site's radio map, as it places them then.

    Parameters
    ----------
    sessions
        In any order; what comes out is in theirs, the same whatever it is.
    """
    ordered = sorted(sessions, key=lambda session: session.session_id)
    dealt = [ordered[group :: growing.groups] for group in range(growing.groups)]
    joined_by_group: list[list[GrownSession]] = [[] for _ in dealt]
    for limit in growing.max_mean_sorensen:
        known: list[list[GrownSession]] = []
        for group, of_group in enumerate(dealt):
            others = [s for i, held in enumerate(joined_by_group) if i != group for s in held]
            grown = with_sessions(site, others)
            placed = [_placed(session, grown, params, growing) for session in of_group]
            known.append([s for s in placed if s is not None and s.mean_sorensen <= limit])
        joined_by_group = known
    chosen = {s.session_id: s for held in joined_by_group for s in held}
    return tuple(chosen[s.session_id] for s in sessions if s.session_id in chosen)


def with_sessions(site: SiteModel, sessions: Iterable[GrownSession]) -> SiteModel:
    """Return the site with the sessions in its radio map, and virtual fingerprints made anew."""
    if site.radio_map is None:
        return site
    return replace(site, radio_map=grown_map(site.radio_map, sessions, site))


def grown_map(radio_map: RadioMap, sessions: Iterable[GrownSession], site: SiteModel) -> RadioMap:
    """Return a map with the sessions in it; with virtual fingerprints if it had some."""
    virtual = is_virtual(radio_map)
    rows = [c.fingerprint for session in sessions for c in session.candidates]
    grown = joined(radio_map.of_rows(~virtual), rows) if rows else radio_map
    if not rows or not virtual.any():
        return grown
    return filled(grown, [floor.walkable for floor in site.floors], VirtualParams())


def _placed(
    session: FinishedSession, site: SiteModel, params: Params, growing: GrowingParams
) -> GrownSession | None:
    """Place a session; None where nothing of it can be placed, or not on a floor for sure."""
    radio_map = site.radio_map
    if radio_map is None:
        return None
    track = smoothed(session.observations, site, params)
    rule = first_of(radio_map.column_by_key), params.match
    floor_ids = radio_map.floor_ids
    rows = tuple(
        candidates(
            session.observations, track, floor_ids, GROWN + session.session_id, rule, growing.rows
        )
    )
    if not rows:
        return None
    known = [_known(row.fingerprint, radio_map, params) for row in rows]
    mean_sorensen, floor_share = np.mean(known, axis=0).tolist()
    if floor_share < growing.min_floor_share:
        return None
    return GrownSession(session.session_id, rows, mean_sorensen)


def _known(fingerprint: Fingerprint, radio_map: RadioMap, params: Params) -> tuple[float, float]:
    """Return how strange a row is, and the share of its candidates that are on its floor."""
    matches = match(Query(fingerprint.wifi_dbm, fingerprint.ble_dbm), radio_map, params.match)
    if matches is None:
        return 1.0, 0.0
    here = matches.floor_index == fingerprint.floor_index
    return matches.nearest_sorensen, float(matches.weight[here].sum())
