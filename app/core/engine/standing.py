"""What a session's track stands on: the floor that it is believed to be on."""

import math

from app.core.derived import derived
from app.core.fingerprint.paths import paths
from app.core.fingerprint.radio_map import RadioMap
from app.core.fusion.ground import Ground, ground
from app.core.fusion.ways import NO_WAYS, WayParams, Ways, ways
from app.core.site import SiteModel
from app.core.types import FloatArray

WAYS = WayParams()


def ground_of(floor_belief: FloatArray | None, site: SiteModel) -> Ground:
    """Return the ground of the most probable floor."""
    return grounds(site)[0 if floor_belief is None else floor_belief.argmax()]


@derived()
def grounds(site: SiteModel) -> tuple[Ground, ...]:
    """Return the ground of each floor; computed once per site model."""
    angle_rad = site.x_axis_from_east_rad
    east = math.cos(angle_rad), -math.sin(angle_rad)
    return tuple(
        ground(
            floor.walkable,
            east,
            NO_WAYS if site.radio_map is None else _ways(site.radio_map, index, east),
        )
        for index, floor in enumerate(site.floors)
    )


# By map, not by site: some tenths of a second a floor, which an edit of a wall must not cost.
@derived(most=256)
def _ways(radio_map: RadioMap, floor_index: int, east: tuple[float, float]) -> Ways:
    return ways(paths(radio_map, floor_index), east, WAYS)
