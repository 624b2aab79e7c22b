"""Wi-Fi fingerprints alone: single scans of unknown phones in three buildings with 13 floors."""

from collections.abc import Sequence
from time import process_time

import numpy as np

from app.core.fingerprint.matching import match
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map
from app.core.params import MatchParams
from app.formats.ujiindoorloc import LabelledScan
from app.services.evaluation.figures import Evaluation, error_figures

PROTOCOL = (
    "map of all training scans that heard something; each validation scan by itself; building and "
    "floor by the weights of the candidates, place their weighted mean on that floor; the error is "
    "2-D over all validation scans, those on a wrong floor or in a wrong building too"
)


def evaluate(training: Sequence[LabelledScan], validation: Sequence[LabelledScan]) -> Evaluation:
    """Return the figures of the matcher with the parameters of the profile `best`."""
    floors = sorted({scan.floor for scan in training})
    radio_map = _radio_map(floors, training)
    params = MatchParams()
    # Compiled code and the map's index are loaded before anything is timed.
    match(Query(validation[0].rssi_dbm, {}), radio_map, params)
    errors_m: list[float] = []
    times_s: list[float] = []
    right = 0
    for scan in validation:
        begin_s = process_time()
        place = _located(scan, radio_map, params)
        times_s.append(process_time() - begin_s)
        if place is not None:
            floor_index, x_m, y_m = place
            errors_m.append(float(np.hypot(x_m - scan.x_m, y_m - scan.y_m)))
            right += floors[floor_index] == scan.floor
    figures = {
        "samples": len(validation),
        "building_and_floor_accuracy": right / len(validation),
        **error_figures(errors_m),
        "no_fix_share": 1.0 - len(errors_m) / len(validation),
        "median_query_ms": 1000.0 * float(np.median(times_s)),
    }
    return Evaluation(
        "ujiindoorloc", "pharos evaluate ujiindoorloc DIR", PROTOCOL, {"fingerprint": figures}
    )


def _radio_map(floors: Sequence[str], training: Sequence[LabelledScan]) -> RadioMap:
    index = {floor: i for i, floor in enumerate(floors)}
    return build_radio_map(
        floors,
        [Fingerprint(index[s.floor], s.x_m, s.y_m, s.rssi_dbm, {}) for s in training if s.rssi_dbm],
    )


def _located(
    scan: LabelledScan, radio_map: RadioMap, params: MatchParams
) -> tuple[int, float, float] | None:
    """Return floor index, x and y; None if no access point of the scan is in the map."""
    matches = match(Query(scan.rssi_dbm, {}), radio_map, params)
    if matches is None:
        return None
    votes = np.bincount(matches.floor_index, matches.weight)
    floor = int(np.argmax(votes))
    weight = np.where(matches.floor_index == floor, matches.weight, 0.0) / votes[floor]
    return floor, float(weight @ matches.x_m), float(weight @ matches.y_m)
