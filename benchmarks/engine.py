"""What one second of one phone costs in the engine: fold and report, and which stage takes it.

Run ``python benchmarks/engine.py [BUILDING [WALKS]]``: simulated walks through the warehouse, and
with a building folder of the Indoor Location Competition 2.0 walks of its fold 0 against the radio
map of the others. Times are CPU time of this thread; between machines only ratios mean something.
"""

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from app.core import engine
from app.core.engine import PROFILES, SessionState
from app.core.engine.profiles import BEST, Stage
from app.core.fusion.ground import ground
from app.core.fusion.particles import Particles, begin, diffuse, update, walk
from app.core.fusion.sighting import Sighting
from app.core.params import Params
from app.core.simulate import walk as simulated_walk
from app.core.simulate import warehouse
from app.core.site import Floor, SiteModel
from app.core.types import FloatArray, Observation
from app.formats.ms2020 import fold_of, read_trace, trace_id_of
from app.formats.ms2020_site import read_building
from app.formats.ms2020_survey import SurveyWalk, survey_walk_or_reason
from app.services.building_import import radio_map_of

Walk: TypeAlias = Sequence[Observation]
PARAMS, ROUNDS = Params(), 2_000


def seconds_of(observations: Walk) -> list[list[Observation]]:
    """Return the observations in batches of one second of event time, in the fold's order."""
    ordered = sorted(observations, key=engine.order_key)
    return [list(batch) for _, batch in groupby(ordered, lambda o: math.floor(o.time_s))]


def batch_times_us(walks: Iterable[Walk], site: SiteModel) -> FloatArray:
    """Return the CPU time of each batch: the fold, and the position that the reply tells."""
    times = []
    for observations in walks:
        state = engine.start()
        for batch in seconds_of(observations):
            start_ns = time.thread_time_ns()
            for observation in batch:
                state, _ = engine.advance(state, observation, site, PARAMS)
            engine.finish(state, site, PARAMS)
            times.append(time.thread_time_ns() - start_ns)
    return np.array(times) / 1e3


def stage_shares(walks: Iterable[Walk], site: SiteModel) -> dict[str, float]:
    """Return each stage's share of the fold; the rest is keys, strides, time and reports."""
    spent_ns: Counter[str] = Counter()

    def timed(stage: Stage) -> Stage:
        def run(
            state: SessionState, observation: Observation, site: SiteModel, params: Params
        ) -> SessionState:
            start_ns = time.thread_time_ns()
            state = stage(state, observation, site, params)
            spent_ns[stage.__name__] += time.thread_time_ns() - start_ns
            return state

        return run

    stages = {kind: tuple(map(timed, row)) for kind, row in BEST.stages.items()}
    PROFILES[BEST.name] = replace(BEST, stages=stages)
    total_us = float(batch_times_us(walks, site).sum())
    PROFILES[BEST.name] = BEST
    shares = {name: spent / 1e3 / total_us for name, spent in spent_ns.most_common()}
    return {**shares, "keys, strides, reports": 1.0 - sum(shares.values())}


def tell(name: str, walks: Sequence[Walk], site: SiteModel) -> None:
    """Print what a second costs on a site that the server has loaded."""
    engine.prepare(site, PARAMS)
    batch_times_us(walks[:1], site)
    times_us = batch_times_us(walks, site)
    rows = 0 if site.radio_map is None else site.radio_map.rows
    print(f"{name}: {len(times_us)} seconds, {len(site.anchors)} anchors, {rows} fingerprints")
    median_us, p99_us = np.percentile(times_us, [50, 99])
    print(f"  mean {times_us.mean():.0f} us, median {median_us:.0f} us, p99 {p99_us:.0f} us")
    for stage, share in stage_shares(walks, site).items():
        print(f"  {stage:24s} {share:6.1%}")


def building_walks(folder: Path, count: int) -> tuple[list[Walk], SiteModel]:
    """Return walks of fold 0, and the site with the radio map of all other folds."""
    building = read_building(folder)
    paths = [path for floor in building.floors for path in floor.traces]
    read = (survey_walk_or_reason(path) for path in paths if fold_of(trace_id_of(path)))
    radio_map = radio_map_of(building, "b", [walk for walk in read if isinstance(walk, SurveyWalk)])
    floors = tuple(
        Floor(floor_id, f.name, building.name, f.ordinal, f.x0_m, f.y0_m, f.width_m, f.height_m)
        for floor_id, f in zip(radio_map.floor_ids, building.floors, strict=True)
    )
    tested = [path for path in paths if not fold_of(trace_id_of(path))]
    walks = [read_trace(path).observations for path in tested[:: len(tested) // count]]
    return walks, SiteModel("b", 1, floors, radio_map=radio_map)


def mean_us(step: Callable[[], object]) -> float:
    """Return the mean CPU time of a call after a first untimed one."""
    step()
    start_ns = time.thread_time_ns()
    for _ in range(ROUNDS):
        step()
    return (time.thread_time_ns() - start_ns) / 1e3 / ROUNDS


def filter_times_us() -> tuple[float, float]:
    """Return a step and a scan with one candidate: all our particles, and filterpy's one EKF."""
    floor = ground(None, (1.0, 0.0))
    seen = Sighting(0.0, np.zeros((1, 2)), np.ones(1), (9.0, 0.0, 9.0), np.ones(1))
    begun = begin(seen, floor, PARAMS.fusion)

    def ours() -> Particles:
        moved = diffuse(walk(begun, (0.7, 0.3), floor, PARAMS.fusion), 0.01, floor)
        return update(moved, seen, floor, PARAMS.fusion)

    ekf = ExtendedKalmanFilter(dim_x=4, dim_z=2)
    ekf.R, observed = 9.0 * np.eye(2), np.eye(2, 4)

    def theirs() -> None:
        c, s = math.cos(0.3), math.sin(0.3)
        ekf.F[:2, 2:] = [[-0.7 * s, 0.7 * c], [0.7 * c, 0.7 * s]]
        ekf.predict()
        ekf.update(np.zeros((2, 1)), lambda _: observed, lambda x: x[:2])

    return mean_us(ours), mean_us(theirs)


def main() -> None:
    """Print the tables."""
    world = warehouse(1)
    tell(
        "simulated warehouse",
        [
            simulated_walk(
                world, seed, start_s=0.0, duration_s=120.0, imu=seed % 2 == 1
            ).observations
            for seed in range(4)
        ],
        world.site,
    )
    if len(sys.argv) > 1:
        count = int(sys.argv[2]) if len(sys.argv) > 2 else 8
        tell(sys.argv[1], *building_walks(Path(sys.argv[1]), count))
    ours_us, theirs_us = filter_times_us()
    print("a step and a scan in the filter")
    print(f"  app.core.fusion          {ours_us:6.0f} us")
    print(f"  filterpy, one EKF        {theirs_us:6.0f} us   {theirs_us / ours_us:.2f} x")


if __name__ == "__main__":
    main()
