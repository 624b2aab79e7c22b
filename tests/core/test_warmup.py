"""The warm-up: after it, a phone's first batch compiles nothing and loads nothing."""

import subprocess
import sys

from app.core import engine
from app.core.engine.anchoring import anchor_floors, anchor_levels, wall_loss_db
from app.core.engine.match_noise import noise_ratio
from app.core.engine.standing import grounds
from app.core.fingerprint.match_index import index_made
from app.core.params import Params
from app.core.simulate import walk, warehouse

# In a process of its own: whatever other tests have called is warm already in this one.
SCRIPT = """
import sys
from numba.core.dispatcher import Dispatcher
from app.core import engine
from app.core.simulate import walk, warehouse

def ready():
    modules = [m for name, m in sys.modules.items() if name.startswith("app.core.")]
    kernels = {k.__module__ + k.__qualname__: k
        for m in modules if "simulate" not in m.__name__
        for k in vars(m).values() if isinstance(k, Dispatcher)}
    return {name: kernel.signatures for name, kernel in kernels.items()}

world = warehouse(1)
assert not any(ready().values())
engine.warm_up()
before = ready()
for imu in (False, True):
    observations = walk(world, 5, start_s=0.0, duration_s=60.0, imu=imu).observations
    for profile in engine.PROFILES.values():
        state = engine.start()
        for observation in observations:
            state, _ = engine.advance(state, observation, world.site, profile.params)
        engine.finish(state, world.site, profile.params)
late = {name: signatures for name, signatures in ready().items() if signatures != before[name]}
assert not late, late
assert sum(map(bool, before.values())) >= 10, before
"""


def test_a_walk_after_the_warm_up_needs_no_further_kernel() -> None:
    command = (sys.executable, "-c", SCRIPT)
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_walk_at_a_prepared_site_works_nothing_of_it_out() -> None:
    world = warehouse(2)
    radio_map = world.site.radio_map
    assert radio_map is not None
    engine.prepare(world.site, Params())
    of_map = (index_made, noise_ratio)
    of_site = (grounds, anchor_floors, anchor_levels, wall_loss_db)

    def kept() -> list[int]:
        return [*(f.kept_of(radio_map) for f in of_map), *(f.kept_of(world.site) for f in of_site)]

    assert kept() == [1, 1, 1, 1, 1, len(world.site.anchors)]
    observations = walk(world, 5, start_s=0.0, duration_s=30.0, imu=True).observations
    state = engine.start()
    for observation in observations:
        state, _ = engine.advance(state, observation, world.site, Params())
    assert kept() == [1, 1, 1, 1, 1, len(world.site.anchors)]
    # The stored track takes the map as the live one did.
    engine.smoothed(observations, world.site, Params())
    assert kept() == [1, 1, 1, 1, 1, len(world.site.anchors)]
