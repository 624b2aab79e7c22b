"""The deployment planner on a hall of 70 x 70 m at 0.5 m with 50 beacons: seconds per task.

Run it with ``python benchmarks/planner.py``. The prediction must come within 2 s; it says so if it
does not, and ends with exit code 1. Kernels are compiled before the clock starts.
"""

import sys
import time
from dataclasses import replace

import msgspec
import numpy as np

from app.api.planner_formats import plan_json
from app.core.site import Wall
from app.core.types import Anchor
from app.services.planning import Frame, PlanRequest, PlanResult, Tasks, plan

SIDE_M, CELL_M, BEACONS, WALLS = 70.0, 0.5, 50, 200
BOUND_S = 2.0


def hall() -> PlanRequest:
    """Return the hall with beacons strewn evenly at random."""
    places = np.random.default_rng(1).uniform(0.0, SIDE_M, (BEACONS, 2)).tolist()
    anchors = tuple(Anchor(f"b{i}", (), "", x, y) for i, (x, y) in enumerate(places))
    frame = Frame(0.0, 0.0, SIDE_M, SIDE_M, CELL_M)
    return PlanRequest(frame, anchors, Anchor("new", (), "", 0.0, 0.0))


def walled(request: PlanRequest) -> PlanRequest:
    """Return the hall cut up by light walls of a few metres."""
    rng = np.random.default_rng(2)
    ends = rng.uniform(0.0, SIDE_M, (WALLS, 2))
    others = ends + rng.uniform(-8.0, 8.0, (WALLS, 2))
    rows = np.hstack((ends, others)).tolist()
    return replace(request, walls=tuple(Wall(*row, attenuation_db=5.0) for row in rows))


def timed(request: PlanRequest) -> tuple[PlanResult, float]:
    """Return the result and the best of three times, s; the figures are written as JSON, too."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        result = plan(request)
        msgspec.json.encode(plan_json(request, result))
        times.append(time.perf_counter() - start)
    return result, min(times)


def main() -> None:
    """Print the table."""
    request = hall()
    empty = replace(request, anchors=(), tasks=Tasks(cover_m=1.5))
    plan(replace(walled(request), tasks=Tasks(drop_one=True, add=1, cover_m=20.0)))
    _, predicted_s = timed(request)
    rows = [
        ("prediction, written as JSON", predicted_s),
        (f"the same behind {WALLS} walls", timed(walled(request))[1]),
        ("and every beacon left out once", timed(replace(request, tasks=Tasks(drop_one=True)))[1]),
        ("and the next 3 beacons", timed(replace(request, tasks=Tasks(add=3)))[1]),
    ]
    start = time.perf_counter()
    cover = plan(empty).cover
    assert cover is not None
    rows.append((f"fewest for 1.5 m: {len(cover.anchors)}", time.perf_counter() - start))
    print(f"{SIDE_M:g} x {SIDE_M:g} m at {CELL_M:g} m, {BEACONS} beacons")
    for name, seconds in rows:
        print(f"  {name:32s} {seconds:7.3f} s")
    print(f"  bound of the prediction          {BOUND_S:7.3f} s")
    if predicted_s > BOUND_S:
        sys.exit("the prediction takes too long")


if __name__ == "__main__":
    main()
