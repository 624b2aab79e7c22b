"""What tao2016 reports, in simulation: with fewer seeds than `pharos evaluate papers`."""

from typing import Any

import numpy as np
import pytest

from app.services.evaluation.papers import tao2016
from app.services.evaluation.papers.tao2016_corridor import PASSERS_BY, Blocking, Corridor


def medians(setting: str, seeds: int) -> dict[str, Any]:
    figures = tao2016.setting_figures(tao2016.SETTINGS[setting], range(seeds))
    return {name: figure["median"] for name, figure in figures.items()}


def test_cleaning_and_smoothing_are_worth_what_the_paper_reports() -> None:
    figures = medians("at_points", 7)
    assert figures["gauss_mean_to_plain_mean_ratio"] <= 0.77
    assert figures["all_steps_to_plain_mean_ratio"] <= 0.52


def test_cleaning_cannot_help_where_a_body_stays_as_long_as_the_window() -> None:
    assert medians("blocked_for_5_s", 3)["gauss_mean_to_plain_mean_ratio"] > 0.85


@pytest.mark.parametrize("noise", ["noise_0_5_db", "noise_3_0_db"])
def test_the_filter_follows_a_step_and_is_quiet_at_rest(noise: str) -> None:
    figures: Any = tao2016.filter_figures(range(5))
    assert figures[f"{noise}_samples_to_follow_10_db"]["median"] <= 8
    assert figures[f"{noise}_variance_to_plain_filter_ratio"]["median"] <= 1.2


def test_every_figure_has_its_spread_and_the_asked_ones_a_target() -> None:
    figures: Any = tao2016.reproduce([0])
    asked = figures["at_points"]["all_steps_to_plain_mean_ratio"]
    assert asked.keys() == {"median", "p10", "p90", "target"}
    assert asked["target"] == 0.52
    assert figures["between_points"]["all_steps_to_plain_mean_ratio"]["target"] is None


def test_the_same_seed_is_the_same_corridor() -> None:
    x_m = np.arange(5.0)
    first, second = (Corridor(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(
        first.listen_dbm(x_m, 10.0, PASSERS_BY), second.listen_dbm(x_m, 10.0, PASSERS_BY)
    )


@pytest.mark.parametrize("blocking", [PASSERS_BY, Blocking(mean_s=5.0)])
def test_the_corridor_is_as_it_says(blocking: Blocking) -> None:
    corridor = Corridor(np.random.default_rng(1))
    x_m = np.linspace(0.5, 39.5, 40)
    heard_dbm = corridor.listen_dbm(x_m, 400.0, blocking)
    mean_dbm = corridor.mean_levels_dbm(x_m)
    # Loud enough to be heard through a body.
    loud = mean_dbm > -75.0
    off_db = np.swapaxes(heard_dbm, 1, 2)[loud] - mean_dbm[loud][:, None]
    received = off_db[~np.isnan(off_db)]
    assert len(received) / off_db.size == pytest.approx(0.8, abs=0.02)
    # Fading scatters by 2 dB; what is farther below is blocked.
    assert np.mean(received < -7.0) == pytest.approx(0.1, abs=0.02)
    assert np.std(received[received > -6.0]) == pytest.approx(2.0, abs=0.3)
