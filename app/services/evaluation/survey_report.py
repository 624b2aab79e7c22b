"""The survey report held against the truth: how well it tells beforehand where scans err."""

import numpy as np
from scipy.stats import spearmanr

from app.core.fingerprint.quality import (
    QualityParams,
    fit_error_model,
    left_out_fixes,
    predicted_error_m,
)
from app.core.params import MatchParams
from app.core.types import FloatArray
from app.services.evaluation.figures import Figures
from app.services.evaluation.single_scans import HeldOut, single_errors_m


def report_figures(held: HeldOut) -> Figures:
    """Return how a map's predicted error by place ranks the true errors of scans it never saw.

    ``worst_to_best_third`` is the mean error of the third of the scans predicted worst over that
    of the third predicted best; ``predicted_to_true`` the mean prediction over the mean error.
    """
    model = fit_error_model(left_out_fixes(held.radio_map, MatchParams()), QualityParams())
    places = np.array([(scan.x_m, scan.y_m) for scan in held.scans])
    floors = np.array([scan.floor_index for scan in held.scans])
    error_m = single_errors_m(held.scans, held.radio_map)
    told = ~np.isnan(error_m)
    predicted_m = predicted_error_m(model, places, floors)[told]
    error_m = error_m[told]
    thirds_m = thirds(predicted_m, error_m)
    return {
        "scans": len(error_m),
        "mean_error_m": float(error_m.mean()),
        "spearman": float(spearmanr(predicted_m, error_m).statistic),
        "best_third_m": thirds_m[0],
        "middle_third_m": thirds_m[1],
        "worst_third_m": thirds_m[2],
        "worst_to_best_third": thirds_m[2] / thirds_m[0],
        "predicted_to_true": float(predicted_m.mean() / error_m.mean()),
    }


def thirds(predicted_m: FloatArray, error_m: FloatArray) -> tuple[float, float, float]:
    """Return the mean error of the scans by thirds of their prediction, the best first."""
    order = np.argsort(predicted_m, kind="stable")
    best, middle, worst = (float(error_m[part].mean()) for part in np.array_split(order, 3))
    return best, middle, worst
