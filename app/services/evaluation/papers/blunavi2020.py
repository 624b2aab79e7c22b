"""blunavi2020's experiment, simulated: cell accuracy of voting, and a walk by each of its methods.

Published: 82.33 % of 3 m cells right; mean errors of dead reckoning 3.88 m, of the propagation
model's ranges 5.91 m, and of the EKF 10.22 m, in a wing where range updates are missing in the
rooms. Nguyen Ngoc Khuong, "BluNavi", Haiphong University Journal of Science 44, 2021.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from app.core.fingerprint import hmm
from app.core.fingerprint.cells import CellMap, CellParams, cell_map
from app.core.fingerprint.hmm import HmmParams
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.fingerprint.voting import VotingParams, heard_columns, hold_ballot
from app.core.fusion.planar import PlanarTrack
from app.core.fusion.range_ekf import (
    RangeEkfParams,
    Ranges,
    carried,
    corrected,
    range_sigma_m,
)
from app.core.radio.line_of_sight import Believed, LineOfSightParams, Sights, lines_of_sight
from app.core.radio.path_loss import DZ2, SLOPE, X, Y, distances_of_levels, level_model
from app.core.radio.windows import window_of
from app.core.types import FloatArray, IntArray
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.papers.blunavi2020_walk import Walk, walk_through
from app.services.evaluation.papers.blunavi2020_wing import (
    BEACONS,
    CELL_M,
    Radio,
    access_points,
    beacons,
    cell_centres,
)

PROTOCOL = (
    "corridor with 16 rooms, 80 cells of 3 m, 20 survey scans at each centre; cell accuracy of 4 "
    "scans a cell at its centre, and anywhere in it; walk: known start, six rooms, beacons heard "
    "in the corridor alone; mean error over all steps (ranging: of the ranges; voting and hmm: of "
    "the scans); ekf_constant_noise: one noise for all ranges, ekf: noise that grows with the "
    "range; ours: ranges of beacons in line of sight, the HMM over cells correcting dead reckoning"
)
TARGETS = {
    "cell_accuracy": 0.8233,
    "dead_reckoning_m": 3.88,
    "ranging_m": 5.91,
    "ekf_constant_noise_m": 10.22,
    "dead_reckoning_over_ranging": 3.88 / 5.91,
    "ranging_over_ekf_constant_noise": 5.91 / 10.22,
    "ours_over_best_row": 1.0,
}
"""What was published; of ours, that it is better than the best row of the same walk."""

SURVEY_SCANS, ASKED_SCANS = 20, 4
START_SIGMA_M = 0.5
CONSTANT_SIGMA_M = 1.0
WINDOW_STEPS = 4

_MODEL = level_model(BEACONS)
_VOTING, _EKF, _HMM, _SIGHT = VotingParams(), RangeEkfParams(), HmmParams(), LineOfSightParams()

Correct: TypeAlias = Callable[[PlanarTrack, int], PlanarTrack]
"""What a method does to its track at a step, after dead reckoning."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The wing's radio map and its cells."""

    radio_map: RadioMap
    cells: CellMap

    def heard(self, scan: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return a scan (access points,) as columns of the map and levels."""
        return heard_columns(Query(_levels(scan), {}), self.radio_map)

    def voted(self, scan: FloatArray) -> int | None:
        """Return the cell that wins a scan's vote."""
        return hold_ballot(*self.heard(scan), self.cells, _VOTING).winner(_VOTING.min_votes)


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """The HMM on one walk: after each of its scans, made at ``step``, causal and smoothed."""

    step: list[int]
    forward: list[FloatArray]
    smoothed: list[FloatArray]


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return the experiment's figures: median and spread over seeds, beside what is published.

    Every seed draws another radio, another walker and another walk.
    """
    runs = [_run(seed) for seed in seeds]
    return {name: over_seeds([run[name] for run in runs], TARGETS.get(name)) for name in runs[0]}


def _run(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    wifi, ble = access_points(rng), beacons(rng)
    survey = _survey(wifi, rng)
    centre, anywhere = (
        _right_cell_share(wifi, survey, off_m, rng) for off_m in (0.0, 0.5 * CELL_M)
    )
    walk = walk_through(wifi, ble, rng)
    levels_dbm = _mean_levels(walk)
    rows = {
        "dead_reckoning_m": _followed_m(walk, lambda track, _: track),
        "ranging_m": _ranging_m(walk, levels_dbm),
        "ekf_constant_noise_m": _followed_m(walk, _by_ranges(levels_dbm, CONSTANT_SIGMA_M)),
        "ekf_m": _followed_m(walk, _by_ranges(levels_dbm, None)),
        "voting_m": _voting_m(walk, survey),
    }
    beliefs = _believe(walk, survey)
    ours_m = _followed_m(walk, _by_everything(walk, survey, beliefs))
    return {
        "cell_accuracy": centre,
        "cell_accuracy_anywhere": anywhere,
        **rows,
        "hmm_m": _belief_error_m(walk, survey, beliefs.step, beliefs.forward),
        "hmm_smoothed_m": _belief_error_m(walk, survey, beliefs.step, beliefs.smoothed),
        "ours_m": ours_m,
        "ours_without_ranges_m": _followed_m(walk, _by_fingerprints(survey, beliefs)),
        "dead_reckoning_over_ranging": rows["dead_reckoning_m"] / rows["ranging_m"],
        "ranging_over_ekf_constant_noise": rows["ranging_m"] / rows["ekf_constant_noise_m"],
        "ours_over_best_row": ours_m / min(rows.values()),
    }


def _survey(wifi: Radio, rng: np.random.Generator) -> Survey:
    """Return scans at the centre of each cell, the surveyor turned to the four sides."""
    places = np.repeat(cell_centres(), SURVEY_SCANS, axis=0)
    heading = np.tile([0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi], len(places) // 4)
    radio_map = build_radio_map(
        ["wing"],
        [
            Fingerprint(0, float(x), float(y), _levels(scan), {}, "survey")
            for (x, y), scan in zip(places, wifi.heard_dbm(places, heading, rng), strict=True)
        ],
    )
    return Survey(radio_map, cell_map(radio_map, CellParams(CELL_M)))


def _levels(scan: FloatArray) -> dict[str, float]:
    return {f"ap:{t}": float(level) for t, level in enumerate(scan) if not np.isnan(level)}


def _right_cell_share(wifi: Radio, survey: Survey, off_m: float, rng: np.random.Generator) -> float:
    """Return the share of scans whose cell wins the vote, made up to ``off_m`` off its centre."""
    places = np.repeat(cell_centres(), ASKED_SCANS, axis=0)
    asked = places + rng.uniform(-off_m, off_m, places.shape)
    scans = wifi.heard_dbm(asked, rng.uniform(0.0, 2.0 * np.pi, len(asked)), rng)
    centres = np.column_stack([survey.cells.x_m, survey.cells.y_m])
    won = [survey.voted(scan) for scan in scans]
    right = [
        cell is not None and np.allclose(centres[cell], place, atol=0.1)
        for cell, place in zip(won, places, strict=True)
    ]
    return float(np.mean(right))


def _followed_m(walk: Walk, correct: Correct) -> float:
    """Return the mean error of a track that is carried by steps and corrected by a method."""
    track = PlanarTrack(walk.start, START_SIGMA_M**2 * np.eye(2))
    errors_m = []
    for i, truth in enumerate(walk.place):
        length_m, heading_rad = float(walk.told_length_m[i]), float(walk.told_heading_rad[i])
        track = correct(carried(track, length_m, heading_rad, _EKF), i)
        errors_m.append(np.hypot(*(track.mean - truth)))
    return float(np.mean(errors_m))


def _mean_levels(walk: Walk) -> FloatArray:
    """Return each step's mean level per beacon (steps, beacons); nan where none was heard."""
    heard = ~np.isnan(walk.beacon_dbm)
    count = heard.sum(axis=1)
    total = np.where(heard, walk.beacon_dbm, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _ranging_m(walk: Walk, levels_dbm: FloatArray) -> float:
    away = walk.place[:, None] - _MODEL.table[None, :, X : Y + 1]
    true_m = np.sqrt((away**2).sum(axis=2) + _MODEL.table[:, DZ2])
    errors_m = np.abs(distances_of_levels(_MODEL, levels_dbm) - true_m)
    return float(np.mean(errors_m[~np.isnan(levels_dbm)]))


def _ranges(which: IntArray, level_dbm: FloatArray) -> Ranges:
    """Return the ranges to some beacons, from the level of each."""
    every = np.zeros(len(BEACONS))
    every[which] = level_dbm
    range_m = distances_of_levels(_MODEL, every)[which]
    table = _MODEL.table[which]
    sigma_m = range_sigma_m(range_m, table[:, SLOPE], _EKF)
    return Ranges(table[:, X : Y + 1], table[:, DZ2], range_m, sigma_m)


def _by_ranges(levels_dbm: FloatArray, constant_sigma_m: float | None) -> Correct:
    """Return the published filter: every range is believed, with a constant noise or its own."""

    def correct(track: PlanarTrack, i: int) -> PlanarTrack:
        which = np.flatnonzero(~np.isnan(levels_dbm[i]))
        if not len(which):
            return track
        ranges = _ranges(which, levels_dbm[i, which])
        if constant_sigma_m is not None:
            ranges = replace(ranges, sigma_m=np.full(len(which), constant_sigma_m))
        return corrected(track, ranges)

    return correct


def _by_fingerprints(survey: Survey, beliefs: Beliefs) -> Correct:
    """Return the HMM's correction of the dead reckoning."""
    belief_at = dict(zip(beliefs.step, beliefs.forward, strict=True))

    def correct(track: PlanarTrack, i: int) -> PlanarTrack:
        if i not in belief_at:
            return track
        # The belief was carried by the same steps: it replaces the track, it is no news to it.
        return PlanarTrack(*hmm.moments(belief_at[i], survey.cells))

    return correct


def _by_everything(walk: Walk, survey: Survey, beliefs: Beliefs) -> Correct:
    """Return what the paper wished for: ranges in line of sight, and the HMM's correction."""
    by_fingerprints = _by_fingerprints(survey, beliefs)

    def correct(track: PlanarTrack, i: int) -> PlanarTrack:
        track = by_fingerprints(track, i)
        # Windows that overlap would tell the same levels twice.
        if i % WINDOW_STEPS:
            return track
        sights = _sights(walk, i, track)
        if not sights.laterate:
            return track
        seen = sights.in_sight
        return corrected(track, _ranges(sights.anchor_index[seen], sights.level_dbm[seen]))

    return correct


def _sights(walk: Walk, i: int, track: PlanarTrack) -> Sights:
    """Return which beacons of the last steps are in line of sight."""
    recent = walk.beacon_dbm[max(i - WINDOW_STEPS + 1, 0) : i + 1]
    step, advertisement, beacon = np.nonzero(~np.isnan(recent))
    time_s = step + advertisement / recent.shape[1]
    window = window_of(beacon, time_s, recent[step, advertisement, beacon])
    return lines_of_sight(window, _MODEL, Believed(track.mean, track.covariance), _SIGHT)


def _believe(walk: Walk, survey: Survey) -> Beliefs:
    """Run the HMM over a walk's scans."""
    step: list[int] = []
    forward: list[FloatArray] = []
    emissions, ways = [], []
    walked = hmm.stood(_HMM)
    for i, scan in enumerate(walk.wifi_dbm):
        length_m, heading_rad = float(walk.told_length_m[i]), float(walk.told_heading_rad[i])
        walked = hmm.with_step(walked, length_m, heading_rad, _HMM)
        if np.isnan(scan).all():
            continue
        prior = hmm.anywhere(survey.cells)
        if forward:
            prior = hmm.predicted(forward[-1], walked, survey.cells, _HMM)
        emissions.append(hmm.log_emission(*survey.heard(scan), survey.cells, _HMM))
        forward.append(hmm.updated(prior, emissions[-1]))
        step.append(i)
        ways.append(walked)
        walked = hmm.stood(_HMM)
    return Beliefs(step, forward, hmm.smoothed(emissions, ways, survey.cells, _HMM))


def _belief_error_m(
    walk: Walk, survey: Survey, step: list[int], beliefs: list[FloatArray]
) -> float:
    found = np.array([hmm.moments(belief, survey.cells)[0] for belief in beliefs])
    return float(np.mean(np.hypot(*(found - walk.place[step]).T)))


def _voting_m(walk: Walk, survey: Survey) -> float:
    """Return the mean error of single scans by vote; a scan without a winner is left out."""
    errors_m = []
    for scan, place in zip(walk.wifi_dbm, walk.place, strict=True):
        cell = survey.voted(scan)
        if cell is not None:
            won = survey.cells.x_m[cell], survey.cells.y_m[cell]
            errors_m.append(np.hypot(won[0] - place[0], won[1] - place[1]))
    return float(np.mean(errors_m))
