"""What the engine works out of a site's anchors, most of it once per site model."""

import numpy as np

from app.core.derived import derived
from app.core.engine.fixing import sums
from app.core.engine.state import SessionState
from app.core.radio.path_loss import LevelModel, level_model
from app.core.radio.wall_losses import NO_LOSS, loss_map_db
from app.core.site import SiteModel
from app.core.types import FloatArray, IntArray


def anchor_votes(state: SessionState, site: SiteModel) -> FloatArray:
    """Return each floor's share of the received power: slabs take 15 to 25 dB."""
    power = 10.0 ** (state.window.rssi_dbm / 10.0)
    return sums(anchor_floors(site)[state.window.anchor_index], power, len(site.floors))


@derived()
def anchor_floors(site: SiteModel) -> IntArray:
    """Return the floor index of each anchor; computed once per site model."""
    return np.array([site.floor_index(a.floor_id) for a in site.anchors], dtype=np.int64)


@derived()
def anchor_levels(site: SiteModel, phone_height_m: float) -> LevelModel:
    """Return the level models of the site's anchors; computed once per site model."""
    return level_model(site.anchors, phone_height_m)


@derived(most=4096)
def wall_loss_db(site: SiteModel, anchor_index: int) -> FloatArray:
    """Return what walls take from an anchor's level; computed when it is first heard."""
    anchor = site.anchors[anchor_index]
    walls = site.floors[site.floor_index(anchor.floor_id)].walls
    if not walls:
        return NO_LOSS
    rows = [(w.x0_m, w.y0_m, w.x1_m, w.y1_m, w.attenuation_db) for w in walls]
    return loss_map_db(np.array(rows), (anchor.x_m, anchor.y_m))
