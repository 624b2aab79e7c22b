"""A made-up warehouse with phones walking through it: seeded, the same for the same seed.

It feeds the demo and tests of behaviour (does the track follow, does the floor change). The radio
model is a sketch of the real thing (log-distance levels, obstacles, spatially correlated shadowing,
fading), so **no claim about the accuracy of positioning is ever made from it**; those come from
recorded walks only.

Read in this order: `building` (floors, racks, stairs, lift), `routes` (who is where when), `radio`
(how loud is what where), `phone` (what the phone makes of both), `world` (all of it joined).
"""

from app.core.simulate.building import STOREYS, Connector, ConnectorKind, Rack, Storey
from app.core.simulate.phone import Phone
from app.core.simulate.routes import Place, WalkTruth
from app.core.simulate.world import SimulatedWalk, Warehouse, walk, warehouse

__all__ = [
    "STOREYS",
    "Connector",
    "ConnectorKind",
    "Phone",
    "Place",
    "Rack",
    "SimulatedWalk",
    "Storey",
    "WalkTruth",
    "Warehouse",
    "walk",
    "warehouse",
]
