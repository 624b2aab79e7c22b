"""The map grows from use: what phones heard on their finished tracks, as candidate fingerprints.

A scan at time t of a session lies at x(t) of the session's smoothed track, which is told with a
radius r(t) that holds 95 % of the truth. Such a row is worth less than a surveyed one, but where
the survey left a hole any row within the radius is better than none: on ms2020 strict limits on r
lose more by the rows they refuse than they gain by the better ones they keep.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from app.core.fingerprint.query import KeyChoice
from app.core.fingerprint.radio_map import Fingerprint, RadioMap
from app.core.fingerprint.survey import scan_levels
from app.core.fingerprint.virtual import is_virtual
from app.core.params import MatchParams
from app.core.types import BoolArray, Observation, TrackPoint

GROWN = "grown:"
"""Survey walks that begin so were not surveyed: a session's id follows."""


def is_surveyed(radio_map: RadioMap) -> BoolArray:
    """Return which rows (rows,) somebody surveyed: neither virtual nor grown."""
    grown = np.array([w.startswith(GROWN) for w in radio_map.survey_walks], dtype=np.bool_)
    return ~is_virtual(radio_map) & ~grown


@dataclass(frozen=True, slots=True)
class GrowthParams:
    """Which rows of finished sessions may become fingerprints.

    Attributes
    ----------
    max_radius95_m
        Rows of a wider radius are refused: 20 m is a deviation of 8 m per axis.
    min_floor_confidence
        A row on the wrong floor does more harm than several that are some metres off.
    max_gap_s
        A scan between two points of a track is placed on the line between them; over a longer gap
        nobody knows which way the phone went.
    """

    max_radius95_m: float = 20.0
    min_floor_confidence: float = 0.9
    max_gap_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fingerprint of a finished session, and how well its place is known.

    ``fingerprint.survey_walk`` names the session.
    """

    fingerprint: Fingerprint
    radius95_m: float
    time_s: float


def candidates(
    observations: Iterable[Observation],
    track: Sequence[TrackPoint],
    floor_ids: Sequence[str],
    walk: str,
    rule: tuple[KeyChoice, MatchParams],
    params: GrowthParams,
) -> Iterator[Candidate]:
    """Yield the scans of a finished session that may become fingerprints.

    Parameters
    ----------
    observations
        Of the session, in the order of the fold.
    track
        Its smoothed track, by time.
    floor_ids
        Floors that the fingerprints' ``floor_index`` refers to; points elsewhere are passed over.
    rule
        As in `walk_fingerprints`: how the map that they are for names a transmitter.
    """
    placed = _placing(track, params)
    index = {floor_id: i for i, floor_id in enumerate(floor_ids)}
    for time_s, wifi_dbm, ble_dbm in scan_levels(observations, rule):
        point = placed(time_s)
        if point is None or point.floor_id not in index:
            continue
        fingerprint = Fingerprint(
            index[point.floor_id], point.x_m, point.y_m, wifi_dbm, ble_dbm, walk
        )
        yield Candidate(fingerprint, point.radius95_m, time_s)


def _placing(
    track: Sequence[TrackPoint], params: GrowthParams
) -> Callable[[float], TrackPoint | None]:
    """Return where the track was at a time; None where that is not known well enough."""
    times = [point.time_s for point in track]

    def placed(time_s: float) -> TrackPoint | None:
        at = bisect_right(times, time_s)
        if at == 0 or (at == len(times) and time_s > times[-1]):
            return None
        before, after = track[at - 1], track[min(at, len(times) - 1)]
        return _between(before, after, time_s) if _known(before, after, params) else None

    return placed


def _known(before: TrackPoint, after: TrackPoint, params: GrowthParams) -> bool:
    return (
        before.floor_id == after.floor_id
        and after.time_s - before.time_s <= params.max_gap_s
        and max(before.radius95_m, after.radius95_m) <= params.max_radius95_m
        and min(before.floor_confidence, after.floor_confidence) >= params.min_floor_confidence
    )


def _between(before: TrackPoint, after: TrackPoint, time_s: float) -> TrackPoint:
    elapsed_s = after.time_s - before.time_s
    share = (time_s - before.time_s) / elapsed_s if elapsed_s > 0.0 else 0.0
    return replace(
        before,
        x_m=before.x_m + share * (after.x_m - before.x_m),
        y_m=before.y_m + share * (after.y_m - before.y_m),
        radius95_m=max(before.radius95_m, after.radius95_m),
    )
