"""What a session's track stands on: the floor that it is believed to be on."""

from functools import lru_cache

import numpy as np

from app.core.fusion.particles import Ground, ground
from app.core.site import SiteModel
from app.core.types import FloatArray


def ground_of(floor_belief: FloatArray | None, site: SiteModel) -> Ground:
    """Return the ground of the most probable floor."""
    return _grounds(site)[0 if floor_belief is None else int(np.argmax(floor_belief))]


@lru_cache(maxsize=32)
def _grounds(site: SiteModel) -> tuple[Ground, ...]:
    return tuple(ground(floor.walkable, site.x_axis_from_east_rad) for floor in site.floors)
