import numpy as np
import pytest
from wifi_hall import SIDE_M, levels_dbm

from app.core.fingerprint.growth import GROWN
from app.core.fingerprint.leaving_out import left_out_matches, single_fix
from app.core.fingerprint.matching import match
from app.core.fingerprint.quality import (
    QualityParams,
    fit_error_model,
    left_out_fixes,
    predicted_error_m,
)
from app.core.fingerprint.radio_map import Fingerprint, RadioMap, build_radio_map, joined
from app.core.fingerprint.survey_report import ReportParams, survey_report
from app.core.fingerprint.virtual import VIRTUAL_WALK
from app.core.params import MatchParams

MATCHING = MatchParams()


def surveyed_hall(rng: np.random.Generator, hole_from_m: float = 26.0) -> RadioMap:
    """Return a survey in rows 2 m apart, each a walk of its own, twice; none in the upper part."""
    return build_radio_map(
        ("hall-F1",),
        [
            Fingerprint(0, x, y, levels_dbm(x, y, rng), {}, f"row-{y:.0f}-{turn}")
            for turn in range(2)
            for y in np.arange(0.0, hole_from_m, 2.0).tolist()
            for x in np.arange(0.0, SIDE_M + 1.0, 2.0).tolist()
        ],
    )


def hall_cells() -> np.ndarray:
    grid = np.arange(1.5, SIDE_M, 3.0)
    return np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)


def test_leaving_a_walk_out_is_matching_with_a_map_that_lacks_it():
    whole = surveyed_hall(np.random.default_rng(1), hole_from_m=10.0)
    for row, query, matches in left_out_matches(whole, MATCHING):
        if row % 17:
            continue
        others = np.array([walk != whole.survey_walks[row] for walk in whole.survey_walks])
        expected = match(query, whole.of_rows(others), MATCHING)
        assert matches is not None
        assert expected is not None
        assert np.allclose(matches.distance, expected.distance)
        assert matches.weight.sum() == pytest.approx(1.0)
        assert single_fix(matches).x_m == pytest.approx(single_fix(expected).x_m, abs=1.5)


def test_virtual_fingerprints_stand_aside():
    whole = surveyed_hall(np.random.default_rng(1), hole_from_m=10.0)
    virtual = [Fingerprint(0, 500.0, 500.0, levels_dbm(20.0, 4.0), {}, VIRTUAL_WALK)] * 40
    with_virtual, without = (
        left_out_fixes(radio_map, MATCHING) for radio_map in (joined(whole, virtual), whole)
    )
    assert np.allclose(with_virtual.error_m, without.error_m)


def test_grown_fingerprints_help_to_match_but_are_not_asked():
    whole = surveyed_hall(np.random.default_rng(1), hole_from_m=10.0)
    alike = levels_dbm(20.0, 4.0)
    grown = [Fingerprint(0, 20.0, 30.0, alike, {}, f"{GROWN}session-{i}") for i in range(40)]
    asked, without = (
        left_out_fixes(radio_map, MATCHING) for radio_map in (joined(whole, grown), whole)
    )
    assert asked.walks == without.walks
    assert np.array_equal(asked.places(), without.places())
    here = np.hypot(without.x_m - 20.0, without.y_m - 4.0) < 1.0
    assert (asked.error_m[here] > without.error_m[here] + 5.0).any()


def test_a_hole_that_only_grew_from_use_is_thin_as_before():
    whole = surveyed_hall(np.random.default_rng(4))
    grown = [
        Fingerprint(0, x, y, levels_dbm(x, y), {}, f"{GROWN}session")
        for y in (30.0, 34.0, 38.0)
        for x in np.arange(0.0, SIDE_M, 2.0).tolist()
    ]
    report = survey_report(joined(whole, grown), [hall_cells()], MATCHING, ReportParams())
    assert report.floors[0].scans == whole.rows
    assert report.thin_spots[0].y_m > 26.0
    assert report.cells.nearest_scan_m.max() > 10.0


def test_a_hole_in_the_survey_is_predicted_worse_as_it_is():
    rng = np.random.default_rng(2)
    radio_map = surveyed_hall(rng)
    model = fit_error_model(left_out_fixes(radio_map, MATCHING), QualityParams())
    cells = hall_cells()
    predicted_m = predicted_error_m(model, cells, np.zeros(len(cells), dtype=np.int64))
    hole = cells[:, 1] > 32.0
    assert predicted_m[hole].mean() > 1.4 * predicted_m[cells[:, 1] < 24.0].mean()


def test_predicted_errors_are_metres():
    radio_map = surveyed_hall(np.random.default_rng(3))
    left_out = left_out_fixes(radio_map, MATCHING)
    model = fit_error_model(left_out, QualityParams())
    predicted_m = predicted_error_m(model, left_out.places(), left_out.floor_index)
    assert predicted_m.mean() == pytest.approx(left_out.error_m.mean(), rel=0.2)


def test_thin_spots_lie_in_the_hole_and_do_not_overlap():
    radio_map = surveyed_hall(np.random.default_rng(4))
    params = ReportParams()
    report = survey_report(radio_map, [hall_cells()], MATCHING, params)
    first = report.thin_spots[0]
    assert first.y_m > 26.0
    places = np.array([(spot.x_m, spot.y_m) for spot in report.thin_spots])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(len(places), 1)]
    assert apart.min() > params.spot_m
    assert sum(spot.cost_share for spot in report.thin_spots) <= 1.0


def test_far_places_that_look_alike_are_told_as_conflicts():
    rng = np.random.default_rng(5)
    twin = [
        Fingerprint(0, x + 100.0, y, levels_dbm(x, y, rng), {}, "twin")
        for y in (0.0, 2.0, 4.0)
        for x in (2.0, 4.0, 6.0)
    ]
    radio_map = joined(surveyed_hall(rng), twin)
    report = survey_report(radio_map, [hall_cells()], MATCHING, ReportParams())
    assert any(c.x_m > 90.0 and c.like_x_m < 50.0 for c in report.conflicts)
    assert report.wrong_floors == ()


def test_scans_that_look_like_another_floor_are_wrong_floor_risks():
    rng = np.random.default_rng(6)
    ground = surveyed_hall(rng, hole_from_m=12.0)
    upper = [Fingerprint(1, 10.0, 4.0, levels_dbm(10.0, 4.0, rng), {}, "upstairs")]
    both = joined(ground.with_floors(("hall-F1", "hall-F2")), upper)
    report = survey_report(both, [hall_cells(), np.zeros((0, 2))], MATCHING, ReportParams())
    (risk,) = (risk for risk in report.wrong_floors if risk.floor_index == 1)
    assert (risk.like_floor_index, risk.scans, risk.share) == (0, 1, 1.0)
    assert report.floors[1].wrong_floor_share == 1.0


@pytest.mark.parametrize("walk", [VIRTUAL_WALK, f"{GROWN}session"])
def test_a_map_that_nobody_surveyed_has_no_report(walk: str):
    unsurveyed = build_radio_map(
        ("hall-F1",), [Fingerprint(0, 1.0, 1.0, levels_dbm(1.0, 1.0), {}, walk)]
    )
    with pytest.raises(ValueError, match="no surveyed scan"):
        survey_report(unsurveyed, [hall_cells()], MATCHING, ReportParams())
