"""The simulated warehouse comes out of the database as it was simulated."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.core.simulate import STOREYS, warehouse
from app.services.demo import install_warehouse
from app.services.demo_plan import PX_PER_M, plan_png
from app.services.site import load_site_model
from app.storage.database import Database
from app.storage.floors import get_plan
from app.storage.migrate import upgrade


@pytest.mark.anyio
async def test_the_stored_warehouse_is_the_simulated_one(tmp_path: Path) -> None:
    world = warehouse(seed=1)
    url = f"sqlite:///{tmp_path / 'demo.db'}"
    upgrade(url)
    database = Database(url)
    try:
        await install_warehouse(database, world, now_s=1_790_000_000.0)
        stored = await database.read(lambda c: load_site_model(c, world.site.site_id))
        plan = await database.read(lambda c: get_plan(c, "warehouse-upper"))
    finally:
        await database.close()
    assert stored is not None
    assert stored.anchors == world.site.anchors
    assert stored.radio_map is not None
    assert stored.radio_map.floor_ids == world.site.radio_map.floor_ids
    assert stored.radio_map.rssi_dbm.tobytes() == world.site.radio_map.rssi_dbm.tobytes()
    for mine, theirs in zip(stored.floors, world.site.floors, strict=True):
        assert (mine.floor_id, mine.ordinal, mine.walls) == (
            theirs.floor_id,
            theirs.ordinal,
            theirs.walls,
        )
        for x_m, y_m in np.random.default_rng(0).uniform((0, 0), (80, 50), (2000, 2)):
            open_here = theirs.walkable.distance_at(x_m, y_m) == 0.0
            assert (mine.walkable.distance_at(x_m, y_m) == 0.0) == open_here, (x_m, y_m)
    assert plan is not None
    assert Image.open(io.BytesIO(plan.image)).size == (80 * PX_PER_M, 50 * PX_PER_M)


def test_the_plan_shows_racks_where_they_are() -> None:
    ground = STOREYS[0]
    image = Image.open(io.BytesIO(plan_png(ground)))
    rack = ground.racks[0]
    in_rack = (rack.x0_m + 1.0, rack.y0_m + 1.0)
    in_aisle = (rack.x0_m + rack.width_m + 1.0, rack.y0_m + 1.0)

    def opacity(x_m: float, y_m: float) -> int:
        return image.getpixel((int(x_m * PX_PER_M), int((50.0 - y_m) * PX_PER_M)))[3]

    assert opacity(*in_rack) > 0
    assert opacity(*in_aisle) == 0
