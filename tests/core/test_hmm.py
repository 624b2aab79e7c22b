"""The hidden Markov model: what it predicts, hears and smooths is what its equations say."""

import math

import numpy as np
import pytest

from app.core.fingerprint.cells import CellParams, cell_map
from app.core.fingerprint.hmm import (
    HmmParams,
    Walked,
    anywhere,
    log_emission,
    moments,
    predicted,
    smoothed,
    stood,
    updated,
    with_step,
)
from app.core.fingerprint.query import Query
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.voting import heard_columns

PARAMS = HmmParams()
EXACT = HmmParams(restart_probability=0.0)


def corridor(length=12, floors=1, seed=1):
    """Return the map of a corridor of cells with three transmitters, four scans a cell."""
    rng = np.random.default_rng(seed)
    rows = [
        Fingerprint(f, 3.0 * i + 1.5, 1.5, heard_at(3.0 * i + 1.5, f, rng), {}, f"w{n}")
        for f in range(floors)
        for i in range(length)
        for n in range(4)
    ]
    return build_radio_map([f"f{f}" for f in range(floors)], rows)


def heard_at(x, floor, rng, noise_db=6.0):
    mean = {f"w:{floor}:{t}": -45.0 - 1.5 * abs(x - t) for t in (0.0, 15.0, 36.0)}
    return {k: v + noise_db * rng.normal() for k, v in mean.items() if v > -90.0}


RADIO_MAP = corridor()
CELLS = cell_map(RADIO_MAP, CellParams())


def at(cell):
    belief = np.zeros(CELLS.cells)
    belief[cell] = 1.0
    return belief


def walked(x, y=0.0, sigma=0.8):
    return Walked(np.array([x, y]), sigma**2 * np.eye(2))


def transition(step, params):
    """Return T by its equation (cells, cells), for covariances that are multiples of 1."""
    places = np.column_stack([CELLS.surveyed_x_m, CELLS.surveyed_y_m])
    away = places[None] - places[:, None] - step.displacement_m
    variance = step.covariance_m2[0, 0]
    normal = np.exp(-0.5 * (away**2).sum(axis=2) / variance) / (2 * math.pi * variance)
    e = params.restart_probability
    return (1 - e) * 9.0 * normal + e / CELLS.cells


def emission(levels, params=PARAMS):
    return log_emission(*heard_columns(Query(levels, {}), RADIO_MAP), CELLS, params)


def test_what_was_walked_moves_the_belief():
    belief = predicted(at(3), walked(6.0), CELLS, PARAMS)
    assert belief.sum() == pytest.approx(1.0)
    assert int(np.argmax(belief)) == 5
    expected = transition(walked(6.0), PARAMS)[3]
    assert belief == pytest.approx(expected / expected.sum())


def test_who_would_have_walked_off_the_map_was_elsewhere():
    belief = np.full(CELLS.cells, 1.0 / CELLS.cells)
    for _ in range(8):
        belief = predicted(belief, walked(3.0), CELLS, EXACT)
    assert belief[:8].sum() < 0.01
    assert belief[8:] == pytest.approx(0.25, abs=0.03)


def test_who_walks_where_no_map_is_starts_anew():
    assert predicted(at(11), walked(40.0), CELLS, PARAMS) == pytest.approx(1 / CELLS.cells)


def test_nobody_changes_floor_but_by_a_new_start():
    radio_map = corridor(floors=2)
    cells = cell_map(radio_map, CellParams())
    belief = np.zeros(cells.cells)
    belief[2] = 1.0
    upstairs = cells.floor_index == 1
    assert predicted(belief, stood(EXACT), cells, EXACT)[upstairs].sum() == 0.0
    assert predicted(belief, stood(PARAMS), cells, PARAMS)[upstairs].sum() < 0.01


def test_a_step_adds_its_way_and_its_errors():
    start = Walked(np.zeros(2), np.zeros((2, 2)))
    params = HmmParams(along_share=0.1, heading_rad=0.2)
    north = with_step(start, 0.7, math.pi / 2, params)
    assert north.displacement_m == pytest.approx([0.0, 0.7])
    assert north.covariance_m2 == pytest.approx(np.diag([0.14**2, 0.07**2]))
    unknown = with_step(north, 0.7, math.nan, params)
    assert unknown.displacement_m == pytest.approx([0.0, 0.7])
    assert np.diag(unknown.covariance_m2 - north.covariance_m2) == pytest.approx([0.245, 0.245])


def test_emission_is_the_product_that_the_equation_says():
    query = {"w:0:0.0": -50.0, "w:0:15.0": -62.0}
    background = PARAMS.background_share / 70.0
    expected = np.zeros(CELLS.cells)
    for c in range(CELLS.cells):
        stored = {
            RADIO_MAP.transmitters[CELLS.column[i]]: i
            for i in range(CELLS.row_start[c], CELLS.row_start[c + 1])
        }
        for key in RADIO_MAP.transmitters:
            share = 0.0
            density = 0.0
            if key in stored:
                i = stored[key]
                share = min(CELLS.heard_share[i], PARAMS.most_heard_share)
                s = CELLS.deviation_db[i]
                z = (query.get(key, 0.0) - CELLS.mean_dbm[i]) / s
                density = math.exp(-0.5 * z * z) / (s * math.sqrt(2 * math.pi))
            heard = share * density + background
            expected[c] += math.log(heard if key in query else 1.0 - share)
    assert emission(query) == pytest.approx(PARAMS.evidence_weight * expected)


def test_a_scan_tells_the_place_and_one_strange_level_does_not_untell_it():
    rng = np.random.default_rng(7)
    levels = heard_at(19.5, 0, rng, 1.0)
    belief = updated(anywhere(CELLS), emission(levels))
    assert abs(moments(belief, CELLS)[0][0] - 19.5) < 3.0
    strange = updated(anywhere(CELLS), emission(levels | {"w:0:0.0": -20.0}))
    assert abs(moments(strange, CELLS)[0][0] - 19.5) < 6.0


def test_smoothing_is_bayes_over_all_paths():
    rng = np.random.default_rng(9)
    steps = [walked(0.0), walked(3.0), walked(4.0), walked(2.0)]
    scans = [emission(heard_at(x, 0, rng)) for x in (4.0, 7.0, 11.0, 13.0)]
    found = smoothed(scans, steps, CELLS, PARAMS)
    joint = np.exp(scans[0]) / CELLS.cells
    for step, scan in zip(steps[1:], scans[1:], strict=True):
        joint = joint[..., None] * (transition(step, PARAMS) * np.exp(scan))
    for i, belief in enumerate(found):
        others = tuple(axis for axis in range(4) if axis != i)
        marginal = joint.sum(axis=others)
        assert belief == pytest.approx(marginal / marginal.sum(), abs=1e-9)


def test_walking_tells_apart_what_one_scan_cannot():
    rng = np.random.default_rng(2)
    errors = {"scans": [], "filter": [], "smoother": []}
    for _ in range(20):
        truth = 1.5 + 3.0 * np.arange(10)
        scans = [emission(heard_at(x, 0, rng)) for x in truth]
        steps = [walked(3.0 + 0.3 * rng.normal()) for _ in truth]
        belief = anywhere(CELLS)
        for scan, step, x in zip(scans, steps, truth, strict=True):
            alone = updated(anywhere(CELLS), scan)
            errors["scans"].append(abs(moments(alone, CELLS)[0][0] - x))
            prior = predicted(belief, step, CELLS, PARAMS) if x > truth[0] else belief
            belief = updated(prior, scan)
            errors["filter"].append(abs(moments(belief, CELLS)[0][0] - x))
        later = smoothed(scans, steps, CELLS, PARAMS)
        errors["smoother"] += [
            abs(moments(b, CELLS)[0][0] - x) for b, x in zip(later, truth, strict=True)
        ]
    mean = {name: np.mean(found) for name, found in errors.items()}
    assert mean["filter"] < 0.8 * mean["scans"]
    assert mean["smoother"] < 0.8 * mean["filter"]


def test_moments_hold_the_cell_itself_and_one_floor():
    mean, covariance = moments(at(4), CELLS)
    assert mean == pytest.approx([13.5, 1.5])
    assert covariance == pytest.approx(0.75 * np.eye(2))
