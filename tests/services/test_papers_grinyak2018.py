"""What Grinyak et al. 2018 report, reproduced on a few seeds."""

import numpy as np
import pytest

from app.core.engine import PROFILES
from app.services.evaluation.papers import PAPERS
from app.services.evaluation.papers.grinyak2018 import reproduce, share_inside

LAYOUTS = ("corners", "corners_and_middles")


def test_papers_are_named_as_their_profiles():
    assert set(PAPERS) <= set(PROFILES)


@pytest.fixture(scope="module")
def figures():
    return reproduce(range(3))


@pytest.mark.parametrize(
    ("layout", "least_m", "most_m"),
    [("corners", 1.83, 2.52), ("corners_and_middles", 0.85, 1.24)],
)
def test_both_tables_come_out(figures, layout, least_m, most_m):
    predicted = figures[layout]["predicted"]
    kinematic = [predicted[f"{end}_kinematic_sigma_m"]["median"] for end in ("least", "most")]
    assert kinematic == pytest.approx([least_m, most_m], abs=0.0051)
    for end in ("least", "most"):
        static_m = predicted[f"{end}_static_sigma_m"]["median"]
        assert static_m == pytest.approx(
            0.5135 * predicted[f"{end}_kinematic_sigma_m"]["median"], rel=1e-3
        )


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("model", ["static", "kinematic"])
def test_a_hundred_solutions_lie_where_d_says(figures, layout, model):
    share = figures[layout][f"{model}_share_inside_2_sigma"]
    assert figures[layout][f"{model}_share_inside_2_sigma_in_band_share"] == 1.0
    assert 0.95 < share["target"] < 0.985


@pytest.mark.parametrize("layout", LAYOUTS)
def test_at_rest_the_static_error_is_about_half_of_the_kinematic_one(figures, layout):
    assert figures[layout]["static_over_kinematic_at_rest"]["median"] == pytest.approx(0.5, abs=0.1)


def test_a_walker_spoils_the_static_model_the_more_the_longer_the_window(figures):
    for layout, reached in (("corners", "6s"), ("corners_and_middles", "4s")):
        ratios = [
            figures[layout][f"static_over_kinematic_walking_{window}"]["median"]
            for window in ("2s", "3s", "4s", "6s")
        ]
        assert ratios == sorted(ratios)
        assert figures[layout][f"static_over_kinematic_walking_{reached}"]["median"] >= 2.0


def test_steps_and_acceleration_tell_the_mode_and_save_the_error(figures):
    walks = {name: figure["median"] for name, figure in figures["rests_and_walks"].items()}
    for evidence in ("steps", "imu", "both"):
        assert walks[f"mode_right_share_by_{evidence}_2s"] >= 0.97
        for window in ("2s", "3s"):
            assert walks[f"error_by_{evidence}_over_known_motion_{window}"] <= 1.03
    assert walks["error_always_kinematic_over_known_motion_2s"] >= 1.2
    assert walks["error_always_static_over_known_motion_3s"] >= 1.3


@pytest.mark.parametrize("layout", LAYOUTS)
def test_levels_alone_rarely_claim_motion_and_see_it_in_long_windows(figures, layout):
    found = [figures[layout][f"motion_found_share_{w}"]["median"] for w in ("2s", "3s", "4s", "6s")]
    assert found == sorted(found)
    assert found[-1] >= 0.95
    for window in ("2s", "3s", "4s", "6s"):
        assert figures[layout][f"false_motion_share_{window}"]["median"] <= 0.05


@pytest.mark.parametrize("variances", [(1.0, 1.0), (4.0, 0.25), (9.0, 1.0)])
def test_the_share_inside_a_circle_is_that_of_draws(variances):
    covariance = np.diag(variances)
    draws = np.random.default_rng(1).multivariate_normal((0.0, 0.0), covariance, 200_000)
    for radius_m in (0.5, 2.0, 4.0):
        drawn = np.mean(np.hypot(*draws.T) <= radius_m)
        assert share_inside(covariance, radius_m) == pytest.approx(drawn, abs=0.005)
