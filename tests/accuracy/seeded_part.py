"""A small part of what `pharos evaluate` measures, the same at every run, in seconds.

When an estimator was improved, write the new figures down: ``python tests/accuracy/seeded_part.py``
and commit what it changes.
"""

import json
from dataclasses import replace
from pathlib import Path

from app.core.evaluate import Place
from app.core.params import Params
from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.formats.ms2020 import fold_of, read_trace, trace_id_of
from app.formats.ms2020_site import read_building
from app.formats.ms2020_survey import read_survey_walk
from app.services.building_import import radio_map_of, site_id_of
from app.services.evaluation.figures import Figures
from app.services.evaluation.ms2020 import score_trace, site_of
from app.services.evaluation.walks import FollowedWalk, follow, walk_figures

BASELINE = Path(__file__).with_name("baseline.json")
SHARED_DATA = Path(__file__).parents[3] / "shared" / "data"

START_S, DURATION_S = 1_790_000_000.0, 90.0
PHONES = range(10, 18)

# One floor, a third of its walks in the map, a few others to be followed.
FLOOR, MAPPED_FOLD, ASKED_FOLD, ASKED = "F2", 2, 1, 8


def simulated() -> Figures:
    """Follow phones through the made-up warehouse; half of them report inertial samples."""
    world = warehouse(seed=5)
    walks = [walk(world, n, START_S, DURATION_S, imu=n % 2 == 0) for n in PHONES]
    return kept(walk_figures([_followed(world, one) for one in walks]))


def _followed(world: Warehouse, simulated_walk: SimulatedWalk) -> FollowedWalk:
    def truth_at(time_s: float) -> Place | None:
        if not START_S <= time_s <= START_S + DURATION_S:
            return None
        place = simulated_walk.truth_at(time_s)
        return Place(world.site.floors[place.floor_index].floor_id, place.x_m, place.y_m)

    return follow(simulated_walk.observations, truth_at, world.site, Params())


def recorded(shared_data: Path) -> Figures:
    """Follow some real walks on one floor; tuning walks only, the held-out ones stay unseen."""
    building = read_building(shared_data / "ms2020" / "site1")
    (floor,) = (floor for floor in building.floors if floor.name == FLOOR)
    building = replace(building, floors=(floor,))
    of_fold = {
        fold: [path for path in floor.traces if fold_of(trace_id_of(path)) == fold]
        for fold in (MAPPED_FOLD, ASKED_FOLD)
    }
    surveyed = [read_survey_walk(path) for path in of_fold[MAPPED_FOLD]]
    site = site_of(building, radio_map_of(building, site_id_of(building.name), surveyed))
    asked = (read_trace(path) for path in of_fold[ASKED_FOLD][:ASKED])
    return kept(walk_figures([score_trace(trace, site, Params()).walk for trace in asked]))


def kept(figures: Figures) -> Figures:
    """Return the figures that do not depend on the machine and are worth guarding."""
    names = ("samples", "mean_error_m", "p95_error_m", "floor_accuracy", "coverage95", "smoothed")
    return {name: figures[name] for name in names}


if __name__ == "__main__":
    found = {"simulated": simulated(), "recorded": recorded(SHARED_DATA)}
    BASELINE.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
