"""What an evaluation asks, and what its map is made of."""

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from app.formats.ms2020 import fold_of
from app.formats.ms2020_site import BuildingFolder, FloorFolder
from app.formats.ms2020_survey import SurveyWalk
from app.services.errors import AppError
from app.services.evaluation.figures import Evaluation
from app.services.evaluation.ms2020 import TEST, TUNING, smallest_md5_share, tasks_of
from app.services.evaluation.report import report_page


def ids_of_fold(fold: int, count: int) -> list[str]:
    return [name for name in (f"trace{i}" for i in range(400)) if fold_of(name) == fold][:count]


def building(*trace_ids: str) -> BuildingFolder:
    traces = tuple(Path("F1") / f"{trace_id}.txt" for trace_id in trace_ids)
    floor = FloorFolder("F1", 0, 0.0, 0.0, 10.0, 10.0, b"", {}, traces)
    return BuildingFolder("mall", (floor,), ())


def test_held_out_traces_are_asked_and_tuning_ones_and_no_others() -> None:
    held, tuning, mapped = ids_of_fold(0, 2), ids_of_fold(1, 3), ids_of_fold(2, 4)
    tasks = tasks_of(building(*held, *tuning, *mapped), ["best"])
    asked = {(task.path.stem, task.split) for task in tasks}
    assert asked == {*((name, TEST) for name in held), *((name, TUNING) for name in tuning)}


def test_without_a_map_for_it_there_is_no_tuning() -> None:
    tasks = tasks_of(building(*ids_of_fold(0, 1), *ids_of_fold(1, 2)), ["best"])
    assert {task.split for task in tasks} == {TEST}


@pytest.mark.parametrize("fold", [0, 2])
def test_a_building_without_traces_or_without_a_map_is_refused(fold: int) -> None:
    with pytest.raises(AppError, match="fold 0"):
        tasks_of(building(*ids_of_fold(fold, 3)), ["best"])


def test_what_is_not_known_is_left_blank_in_the_page() -> None:
    # Figures of a profile without a fix are NaN; as JSON, and read again, they are None.
    for unknown in (math.nan, None):
        figures = {"mean_error_m": unknown, "by_decile": (unknown, unknown), "fixes": 0}
        page = report_page([Evaluation("kolakowski", "command", "protocol", {"best": figures})])
        rows = [line for line in page.splitlines() if line.startswith("| `")]
        assert rows == ["| `mean_error_m` |  |", "| `by_decile` |  |", "| `fixes` | 0 |"]


def test_a_share_of_the_map_is_per_floor_and_by_md5() -> None:
    walks = [
        SurveyWalk(f"{floor}{i}", floor, (), np.empty((0, 3)))
        for floor, count in (("F1", 8), ("F2", 4), ("F3", 1))
        for i in range(count)
    ]
    chosen = [walk.trace_id for walk in smallest_md5_share(walks, 0.25)]

    def smallest(floor: str, count: int) -> list[str]:
        names = [walk.trace_id for walk in walks if walk.floor_name == floor]
        return sorted(names, key=lambda name: hashlib.md5(name.encode()).hexdigest())[:count]

    assert sorted(chosen) == sorted([*smallest("F1", 2), *smallest("F2", 1), *smallest("F3", 1)])
