"""The raster of walkable floor."""

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from app.formats.walkable import WalkableError, rasterise_walkable


def test_distance_is_zero_inside_and_grows_outside() -> None:
    raster = rasterise_walkable([box(0, 0, 20, 10)])
    assert raster.distance_at(10, 5) == 0
    assert raster.distance_at(23, 5) == pytest.approx(3, abs=0.5)
    assert raster.distance_at(-4, 5) == pytest.approx(4, abs=0.5)


def test_obstacles_are_cut_out() -> None:
    raster = rasterise_walkable([box(0, 0, 20, 20)], [box(5, 5, 15, 15)])
    assert raster.distance_at(10, 10) == pytest.approx(5, abs=0.5)
    assert raster.distance_at(2, 10) == 0


def test_overlapping_walkable_polygons_join() -> None:
    raster = rasterise_walkable([box(0, 0, 10, 4), box(8, 0, 20, 4)], cell_m=1.0)
    assert raster.distance_at(9, 2) == 0
    assert raster.distance_at(19, 2) == 0
    assert np.count_nonzero(raster.distance_m == 0) == 80


@pytest.mark.parametrize(
    ("walkable", "obstacles"),
    [
        ([], []),
        ([box(0, 0, 5, 5)], [box(-1, -1, 6, 6)]),
        ([Polygon([(0, 0), (40, 0), (40, 0.01)])], []),
        ([box(0, 0, 50_000, 50_000)], []),
    ],
)
def test_outlines_without_a_usable_place_are_refused(walkable: list, obstacles: list) -> None:
    with pytest.raises(WalkableError):
        rasterise_walkable(walkable, obstacles)
