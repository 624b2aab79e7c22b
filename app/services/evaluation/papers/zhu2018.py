"""Reproduction of zhu2018: a round through a hall, followed with fingerprints and a pedometer.

The paper has figures only: a smooth track, no jumping back, no errors at corners.

Source: Zhu, Wang, Chen, Fang, Zhang, "Fusion location algorithm based on Bluetooth and pedometer",
Packaging Engineering 39(5), 2018.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.core.types import FloatArray
from app.services.evaluation.figures import Figures, over_seeds
from app.services.evaluation.papers.zhu2018_rounds import (
    Round,
    Tracks,
    backward_jump_m,
    followed,
    walked_rounds,
    worst_corner,
)

PROTOCOL = (
    "hall of 70 x 70 m without obstacles, 50 beacons, surveyed every 2 m; a rectangle of 49.5 x 33 "
    "m walked in 132 s by three people per hall, BLE scans at 1 Hz; phones held 10 degrees off "
    "(1 sigma) that miss 3 % of the steps and take each for 0.66 m; scored at each scan from the "
    "first fix on; the pedometer alone starts at the first fix; a corner counts by where the track "
    "turns"
)

MAX_BACKWARD_M, MAX_CORNER_S, MAX_CORNER_M = 2.0, 3.0, 3.0


class Outcome(NamedTuple):
    """One round: mean and end error of the three tracks, the jump back, the worst corner."""

    fused_mean_m: float
    fused_end_m: float
    fingerprints_mean_m: float
    fingerprints_end_m: float
    pedometer_mean_m: float
    pedometer_end_m: float
    backward_jump_m: float
    corner_s: float
    corner_m: float

    @property
    def mean_below_both(self) -> bool:
        """Whether the mean error is below that of either source alone."""
        return self.fused_mean_m < min(self.fingerprints_mean_m, self.pedometer_mean_m)

    @property
    def end_below_both(self) -> bool:
        """Whether the error at the end is."""
        return self.fused_end_m < min(self.fingerprints_end_m, self.pedometer_end_m)

    @property
    def corners_kept(self) -> bool:
        """Whether the track turns near every corner."""
        return self.corner_s <= MAX_CORNER_S and self.corner_m <= MAX_CORNER_M


def reproduce(seeds: Sequence[int]) -> Figures:
    """Return errors, jumps and corners over all rounds, and the share of rounds within bounds.

    The target of an error of the fused track is the smaller of the two sources' medians.
    """
    outcomes = [outcome(walk) for seed in seeds for walk in walked_rounds(seed)]
    values = {name: [getattr(o, name) for o in outcomes] for name in Outcome._fields}
    mean_m, end_m = (
        min(np.median(values[f"{source}_{kind}_m"]) for source in ("fingerprints", "pedometer"))
        for kind in ("mean", "end")
    )
    return {
        "mean_error_m": {
            "fused": over_seeds(values["fused_mean_m"], float(mean_m)),
            "fingerprints": over_seeds(values["fingerprints_mean_m"]),
            "pedometer": over_seeds(values["pedometer_mean_m"]),
        },
        "end_error_m": {
            "fused": over_seeds(values["fused_end_m"], float(end_m)),
            "fingerprints": over_seeds(values["fingerprints_end_m"]),
            "pedometer": over_seeds(values["pedometer_end_m"]),
        },
        "backward_jump_m": over_seeds(values["backward_jump_m"], MAX_BACKWARD_M),
        "worst_corner_s": over_seeds(values["corner_s"], MAX_CORNER_S),
        "worst_corner_m": over_seeds(values["corner_m"], MAX_CORNER_M),
        "share_of_rounds": {
            "mean_below_both": _share([o.mean_below_both for o in outcomes]),
            "end_below_both": _share([o.end_below_both for o in outcomes]),
            "no_backward_jump": _share([o.backward_jump_m <= MAX_BACKWARD_M for o in outcomes]),
            "corners_kept": _share([o.corners_kept for o in outcomes]),
        },
    }


def outcome(walk: Round) -> Outcome:
    """Return what one round comes to."""
    tracks = followed(walk)
    corner_s, corner_m = worst_corner(walk, tracks)
    return Outcome(
        *_errors_m(tracks, tracks.fused_m),
        *_errors_m(tracks, tracks.fingerprints_m),
        *_errors_m(tracks, tracks.pedometer_m),
        backward_jump_m(tracks),
        corner_s,
        corner_m,
    )


def _errors_m(tracks: Tracks, track_m: FloatArray) -> tuple[float, float]:
    """Return the mean error of a track and that of its end."""
    errors_m = np.hypot(*(track_m - tracks.truth_m).T)
    return float(errors_m.mean()), float(errors_m[-1])


def _share(met: Sequence[bool]) -> dict[str, float | None]:
    return {"median": float(np.mean(met)), "p10": None, "p90": None, "target": None}
