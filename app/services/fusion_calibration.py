"""Calibration of liu2016's blending: its weights, fitted on walks with known positions."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.core.engine import advance, start
from app.core.engine.liu2016 import Liu2016Params
from app.core.fusion.blending import BlendedMotion, BlendingParams
from app.core.fusion.blending_weights import FusionFit, LabelledEpoch, fit_weights, labelled
from app.core.site import SiteModel
from app.core.types import FloatArray
from app.formats.ms2020 import Trace, trace_id_of, truth_at
from app.formats.ms2020_site import BuildingFolder
from app.formats.ms2020_survey import SurveyWalk
from app.services.building_import import radio_map_of, site_id_of
from app.services.evaluation.ms2020 import score_trace, site_of
from app.services.evaluation.walks import walk_figures

# Each fit changes what the next one rests on; after three, weights move by less than their errors.
ROUNDS = 3


@dataclass(frozen=True, slots=True)
class FusionCalibration:
    """What labelled walks tell of the weights.

    Attributes
    ----------
    fit
        The weights with their standard errors, or which of them cannot be told apart.
    before, after
        The weights to start with, and with what could be fitted.
    before_error_m, after_error_m
        Mean error of the profile on the very same walks, with either.
    """

    traces: int
    fit: FusionFit
    before: BlendingParams
    after: BlendingParams
    before_error_m: float
    after_error_m: float


def map_paths(building: BuildingFolder, labelled_traces: Iterable[Path]) -> list[Path]:
    """Return the traces that the map is made of: all of the building's but the labelled ones."""
    left_out = {trace_id_of(path) for path in labelled_traces}
    every = (path for floor in building.floors for path in floor.traces)
    return [path for path in every if trace_id_of(path) not in left_out]


def calibration_site(building: BuildingFolder, walks: Sequence[SurveyWalk]) -> SiteModel:
    """Return the building with a map of these walks.

    Raises
    ------
    AppError
        If no scan of them can be placed.
    """
    return site_of(building, radio_map_of(building, site_id_of(building.name), walks))


def calibrated_fusion(traces: Sequence[Trace], site: SiteModel) -> FusionCalibration:
    """Return the weights fitted on traces with waypoints, and what they change."""
    params = Liu2016Params()
    blending = params.blending
    for _ in range(ROUNDS):
        current = replace(params, blending=blending)
        fit = fit_weights([e for trace in traces for e in labelled_epochs(trace, site, current)])
        blending = fit.onto(blending)
    return FusionCalibration(
        traces=len(traces),
        fit=fit,
        before=params.blending,
        after=blending,
        before_error_m=_mean_error_m(traces, site, params),
        after_error_m=_mean_error_m(traces, site, replace(params, blending=blending)),
    )


def labelled_epochs(
    trace: Trace, site: SiteModel, params: Liu2016Params
) -> Iterator[LabelledEpoch]:
    """Follow a trace and yield what each blending rested on, where both its ends are surveyed."""
    state = start()
    for observation in trace.observations:
        before = state.memory
        state, _ = advance(state, observation, site, params)
        after = state.memory
        if not isinstance(before, BlendedMotion) or not isinstance(after, BlendedMotion):
            continue
        from_true = _true_place(trace, site, before.time_s)
        to_true = _true_place(trace, site, after.time_s)
        if after.time_s > before.time_s and from_true is not None and to_true is not None:
            yield labelled(before, after, from_true, to_true)


def _true_place(trace: Trace, site: SiteModel, time_s: float) -> FloatArray | None:
    xy_m = truth_at(trace.waypoints, time_s)
    if xy_m is None:
        return None
    (floor,) = (floor for floor in site.floors if floor.name == trace.floor_name)
    return np.array([xy_m[0] + floor.x0_m, xy_m[1] + floor.y0_m])


def _mean_error_m(traces: Sequence[Trace], site: SiteModel, params: Liu2016Params) -> float:
    walks = [score_trace(trace, site, params).walk for trace in traces]
    return float(walk_figures(walks)["mean_error_m"])
