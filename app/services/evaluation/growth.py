"""Growth of the map from use: a few surveyed walks, twice as many that nobody labelled."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from app.core.engine import PROFILES
from app.core.engine.growing import FinishedSession, GrowingParams, condensed, grow, grown_map
from app.core.fingerprint.growth_effect import growth_effect
from app.core.site import SiteModel
from app.core.types import BleScan, WifiScan
from app.formats.ms2020 import Trace, fold_of
from app.formats.ms2020_site import BuildingFolder
from app.formats.ms2020_survey import SurveyWalk
from app.services.building_import import radio_map_of, site_id_of
from app.services.evaluation.figures import Figures
from app.services.evaluation.ms2020 import Split, score_trace, site_of
from app.services.evaluation.walks import walk_figures

PROTOCOL = (
    "folds as in `pharos evaluate ms2020`; of each floor's walks of the map folds, in the order of "
    "md5(seed:trace id), the first quarter is surveyed, the next half is traffic without labels; "
    "the map of the surveyed walks is asked the walks of the asked fold before and after it grew "
    "by the traffic; figures as there: mean errors, the share of seconds on the right floor, and "
    "the share inside the told radius95_m"
)

SURVEYED, USED = 0.25, 0.75
"""Shares of a floor's walks up to which they are surveyed, and up to which they are traffic."""

_PARAMS = PROFILES["best"].params


@dataclass(frozen=True, slots=True)
class Parted:
    """The traces of one seed."""

    surveyed: tuple[Trace, ...]
    traffic: tuple[Trace, ...]


def parted(traces: Iterable[Trace], mapped: frozenset[int], seed: int) -> Parted:
    """Deal the traces of the map folds."""
    by_floor: dict[str, list[Trace]] = {}
    usable = (t for t in traces if fold_of(t.trace_id) in mapped and len(t.waypoints))
    for trace in sorted(usable, key=lambda t: _md5(f"{seed}:{t.trace_id}")):
        by_floor.setdefault(trace.floor_name, []).append(trace)
    surveyed: list[Trace] = []
    traffic: list[Trace] = []
    for of_floor in by_floor.values():
        first = max(round(SURVEYED * len(of_floor)), 1)
        surveyed += of_floor[:first]
        traffic += of_floor[first : round(USED * len(of_floor))]
    return Parted(tuple(surveyed), tuple(traffic))


def growth_figures(
    building: BuildingFolder, traces: Sequence[Trace], split: Split, seeds: Iterable[int]
) -> Iterator[tuple[str, Figures]]:
    """Yield the figures of each seed under its name."""
    asked = [trace for trace in traces if fold_of(trace.trace_id) == split.asked]
    for seed in seeds:
        yield f"seed {seed}", _seed_figures(building, parted(traces, split.mapped, seed), asked)


def _seed_figures(building: BuildingFolder, dealt: Parted, asked: Sequence[Trace]) -> Figures:
    site_id = site_id_of(building.name)
    surveyed = radio_map_of(building, site_id, [_survey_walk(trace) for trace in dealt.surveyed])
    site = site_of(building, surveyed)
    sessions = [
        FinishedSession(trace.trace_id, condensed(trace.observations, site, _PARAMS))
        for trace in dealt.traffic
    ]
    joining = grow(sessions, site, _PARAMS, GrowingParams())
    grown = replace(site, radio_map=grown_map(surveyed, joining, site))
    told = growth_effect(surveyed, grown_map(surveyed, joining, site), _PARAMS.match)
    before, after = _followed(asked, site), _followed(asked, grown)
    return {
        "surveyed_walks": len(dealt.surveyed),
        "traffic_walks": len(dealt.traffic),
        "joined_walks": len(joining),
        "grown_fingerprints": sum(len(session.candidates) for session in joining),
        "asked_walks": len(asked),
        "mean_error_before_m": before["mean_error_m"],
        "mean_error_after_m": after["mean_error_m"],
        "gain_m": before["mean_error_m"] - after["mean_error_m"],
        "floor_accuracy_before": before["floor_accuracy"],
        "floor_accuracy_after": after["floor_accuracy"],
        "coverage95_before": before["coverage95"],
        "coverage95_after": after["coverage95"],
        "cross_validated_before_m": told.before_m,
        "cross_validated_after_m": told.after_m,
    }


def _survey_walk(trace: Trace) -> SurveyWalk:
    scans = tuple(o for o in trace.observations if isinstance(o, WifiScan | BleScan))
    return SurveyWalk(trace.trace_id, trace.floor_name, scans, trace.waypoints)


def _followed(traces: Sequence[Trace], site: SiteModel) -> Figures:
    return walk_figures([score_trace(trace, site, _PARAMS).walk for trace in traces])


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
