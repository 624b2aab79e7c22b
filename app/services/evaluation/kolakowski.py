"""Known beacons in a flat: a slow robot, by path loss alone, by radio map, and by the engine."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from app.core.engine import PROFILES, advance, finish, smoothed, start
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.params import MatchParams
from app.core.radio.beacon_places import BeaconPlacesParams
from app.core.radio.local_mean import local_means_dbm
from app.core.radio.windows import window_of
from app.core.site import Floor, SiteModel, Wall
from app.core.types import Anchor, BleScan, Reading, TrackPoint
from app.formats.kolakowski import FLOOR, RobotRecording
from app.services.evaluation.beacons import (
    LATERATION,
    Place,
    Surroundings,
    laterated,
    matched,
    placed,
    surveyed,
)
from app.services.evaluation.figures import Evaluation, Figures, error_figures

PROTOCOL = (
    "receivers, and what a face of the plan's walls takes, calibrated and map surveyed on the "
    "calibration drive; asked at every row of the test drive, causal, with the levels of the last "
    "2 s; engine: the profiles best, grinyak2018 and blunavi2020 (the latter two without walls), "
    "fed with the same rows as scans, and their stored tracks; methods were compared on quarters "
    "of the calibration drive, each asked with what the other three calibrate; estimated_places: "
    "lateration without walls among receivers whose places were estimated on the calibration "
    "drive; roles reversed, the robot transmits"
)
WINDOW_S = 2.0
TRANSMITTER_HEIGHT_M = 1.3


def evaluate(
    anchors: Sequence[Anchor],
    walls: Sequence[Wall],
    calibration: RobotRecording,
    asked: RobotRecording,
) -> Evaluation:
    """Return the figures of every method."""
    row, heard = np.nonzero(~np.isnan(calibration.rssi_dbm))
    levels = np.column_stack(
        [heard, calibration.x_m[row], calibration.y_m[row], calibration.rssi_dbm[row, heard]]
    )
    with_walls = surveyed(anchors, levels, walls, TRANSMITTER_HEIGHT_M)
    open_plan = surveyed(anchors, levels, (), TRANSMITTER_HEIGHT_M)
    radio_map = _radio_map(anchors, calibration)
    laterating, mapped = _site(open_plan, None), _site(with_walls, radio_map)
    profiles = {
        "lateration": _figures(asked, _lateration(asked, with_walls)),
        "fingerprint": _figures(asked, _fingerprint(asked, anchors, radio_map)),
        "best_path_loss": _engine_figures(asked, _site(with_walls, None), "best"),
        "best_path_loss_without_walls": _engine_figures(asked, laterating, "best"),
        "best_radio_map": _engine_figures(asked, mapped, "best"),
        "grinyak2018": _engine_figures(asked, laterating, "grinyak2018"),
        "blunavi2020_ranges": _engine_figures(asked, laterating, "blunavi2020"),
        "blunavi2020_votes": _engine_figures(asked, mapped, "blunavi2020"),
        "estimated_places": _estimated_figures(anchors, calibration, asked),
    }
    return Evaluation("kolakowski", "pharos evaluate kolakowski DIR", PROTOCOL, profiles)


def _estimated_figures(
    anchors: Sequence[Anchor], calibration: RobotRecording, asked: RobotRecording
) -> Figures:
    """Return lateration among receivers whose places were estimated on the calibration drive."""
    row, index = np.nonzero(~np.isnan(calibration.rssi_dbm))
    x_m, y_m = calibration.x_m[row], calibration.y_m[row]
    cells, group, count = np.unique(
        np.column_stack([index, np.floor(x_m), np.floor(y_m)]),
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    group = group.reshape(-1)
    means_dbm = local_means_dbm(group, calibration.rssi_dbm[row, index], len(cells))
    places = (np.bincount(group, axis) / count for axis in (x_m, y_m))
    params = BeaconPlacesParams()
    z_m = TRANSMITTER_HEIGHT_M + params.height_m
    heard = np.column_stack([cells[:, 0], *places, means_dbm])
    estimated, errors = placed(anchors, heard, z_m, params)
    return {
        **_figures(asked, _lateration(asked, estimated)),
        "place_mean_error_m": float(np.mean([place.error_m for place in errors])),
        "place_coverage95": float(np.mean([place.is_inside95 for place in errors])),
    }


def _figures(asked: RobotRecording, locate: Callable[[int], Place | None]) -> Figures:
    return _of_places(asked, [locate(row) for row in range(len(asked.time_s))])


def _of_places(asked: RobotRecording, places: Sequence[Place | None]) -> Figures:
    errors_m = [
        float(np.hypot(place[0] - x_m, place[1] - y_m))
        for place, x_m, y_m in zip(places, asked.x_m, asked.y_m, strict=True)
        if place is not None
    ]
    no_fix_share = 1.0 - len(errors_m) / len(places)
    return {"samples": len(errors_m), **error_figures(errors_m), "no_fix_share": no_fix_share}


def _recent(recording: RobotRecording, row: int) -> slice:
    from_s = recording.time_s[row] - WINDOW_S
    return slice(int(np.searchsorted(recording.time_s, from_s, side="right")), row + 1)


def _lateration(asked: RobotRecording, among: Surroundings) -> Callable[[int], Place | None]:
    def locate(row: int) -> Place | None:
        recent = _recent(asked, row)
        levels = asked.rssi_dbm[recent]
        line, heard = np.nonzero(~np.isnan(levels))
        window = window_of(heard, asked.time_s[recent][line], levels[line, heard])
        return laterated(window, among, LATERATION)

    return locate


def _mean_levels(
    recording: RobotRecording, row: int, anchors: Sequence[Anchor]
) -> dict[str, float]:
    levels = recording.rssi_dbm[_recent(recording, row)]
    means = {}
    for i, anchor in enumerate(anchors):
        heard = levels[~np.isnan(levels[:, i]), i]
        if len(heard):
            means[anchor.keys[0]] = float(heard.mean())
    return means


def _radio_map(anchors: Sequence[Anchor], surveyed: RobotRecording) -> RadioMap:
    rows = range(len(surveyed.time_s))
    places = zip(surveyed.x_m.tolist(), surveyed.y_m.tolist(), strict=True)
    return build_radio_map(
        [FLOOR],
        [
            Fingerprint(0, x_m, y_m, {}, _mean_levels(surveyed, row, anchors))
            for row, (x_m, y_m) in zip(rows, places, strict=True)
        ],
    )


def _fingerprint(
    asked: RobotRecording, anchors: Sequence[Anchor], radio_map: RadioMap
) -> Callable[[int], Place | None]:
    params = MatchParams()

    def locate(row: int) -> Place | None:
        levels_dbm = _mean_levels(asked, row, anchors)
        return matched(levels_dbm, radio_map, params) if levels_dbm else None

    return locate


def _plan_m(among: Surroundings) -> tuple[float, float, float, float]:
    """Return the rectangle around anchors and walls: left, low, right, high."""
    ends = [(w.x0_m, w.y0_m) for w in among.walls] + [(a.x_m, a.y_m) for a in among.anchors]
    (left_m, low_m), (right_m, high_m) = np.min(ends, axis=0), np.max(ends, axis=0)
    return float(left_m), float(low_m), float(right_m), float(high_m)


def _site(among: Surroundings, radio_map: RadioMap | None) -> SiteModel:
    """Return the flat, with either a radio map or anchors."""
    left_m, low_m, right_m, high_m = _plan_m(among)
    floor = Floor(
        FLOOR, FLOOR, FLOOR, 0, left_m, low_m, right_m - left_m, high_m - low_m, walls=among.walls
    )
    return SiteModel("flat", 1, (floor,), () if radio_map is not None else among.anchors, radio_map)


def _engine_figures(asked: RobotRecording, site: SiteModel, profile: str) -> Figures:
    usual = PROFILES[profile].params
    lateration = replace(usual.lateration, phone_height_m=TRANSMITTER_HEIGHT_M)
    params = replace(usual, lateration=lateration)
    keys = range(asked.rssi_dbm.shape[1])
    scans = [
        BleScan(
            float(time_s),
            tuple(Reading((f"{i + 1}",), float(row[i])) for i in keys if not np.isnan(row[i])),
        )
        for time_s, row in zip(asked.time_s, asked.rssi_dbm, strict=True)
    ]
    state, answers = start(), []
    for scan in scans:
        state, _ = advance(state, scan, site, params)
        output = finish(state, site, params)[-1]
        answers.append(output if isinstance(output, TrackPoint) else None)
    places = [None if answer is None else (answer.x_m, answer.y_m) for answer in answers]
    track = smoothed(scans, site, params)
    x_m, y_m, time_s = np.array([(p.x_m, p.y_m, p.time_s) for p in track]).T
    true_x_m = np.interp(time_s, asked.time_s, asked.x_m)
    true_y_m = np.interp(time_s, asked.time_s, asked.y_m)
    after = error_figures(np.hypot(x_m - true_x_m, y_m - true_y_m))
    return {**_of_places(asked, places), **_coverage(asked, answers), "smoothed": after}


def _coverage(asked: RobotRecording, answers: Sequence[TrackPoint | None]) -> Figures:
    """Return the share of the truth inside the radius that is told for 95 %, and that radius."""
    told = [
        (np.hypot(answer.x_m - x_m, answer.y_m - y_m), answer.radius95_m)
        for answer, x_m, y_m in zip(answers, asked.x_m, asked.y_m, strict=True)
        if answer is not None
    ]
    errors_m, radii_m = np.array(told).reshape(-1, 2).T
    return {
        "coverage95": float(np.mean(errors_m <= radii_m)),
        "mean_radius95_m": float(np.mean(radii_m)),
    }
