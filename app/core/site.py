"""The immutable snapshot of a site that a session folds with: floors, anchors, radio map."""

from dataclasses import dataclass, field

from app.core.fingerprint.radio_map import RadioMap
from app.core.geometry import Walkable
from app.core.types import Anchor


@dataclass(frozen=True, slots=True)
class Wall:
    """A wall segment and what it takes from a level that passes it."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    attenuation_db: float = 4.0


@dataclass(frozen=True, slots=True)
class Floor:
    """One level of a building in the site frame.

    ``x0_m, y0_m`` is the lower left corner of its plan, ``width_m, height_m`` the plan's size.
    """

    floor_id: str
    name: str
    building: str
    ordinal: int
    x0_m: float
    y0_m: float
    width_m: float
    height_m: float
    walkable: Walkable | None = None
    walls: tuple[Wall, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class SiteModel:
    """Everything the engine knows of a place; replaced as a whole when an admin changes something.

    Attributes
    ----------
    floors
        Ordered; ``floor_index`` everywhere in core is the index into this tuple.
    x_axis_from_east_rad
        Direction of the plan's +x axis, counter-clockwise from east. A heading that a phone reports
        less this is its heading on the plan.
    """

    site_id: str
    version: int
    floors: tuple[Floor, ...]
    anchors: tuple[Anchor, ...] = ()
    radio_map: RadioMap | None = None
    x_axis_from_east_rad: float = 0.0
    anchor_by_key: dict[str, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        index = {key: i for i, anchor in enumerate(self.anchors) for key in anchor.keys}
        object.__setattr__(self, "anchor_by_key", index)

    def floor_index(self, floor_id: str) -> int:
        """Return the index of a floor; KeyError if the site has no such floor."""
        for i, floor in enumerate(self.floors):
            if floor.floor_id == floor_id:
                return i
        raise KeyError(floor_id)
