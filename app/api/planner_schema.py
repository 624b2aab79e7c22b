"""What a plan is asked with, over HTTP and in the file of ``pharos plan``."""

from typing import Annotated, Literal

from pydantic import Field

from app.api.georeference import ControlPoint
from app.api.resource import Metres, Name, StrictModel
from app.core.radio.walls import HearingParams

MAX_BEACONS = 500

Decibels = Annotated[float, Field(gt=0, le=40)]
Exponent = Annotated[float, Field(ge=0.5, le=8)]
Level = Annotated[float, Field(ge=-120, le=20)]
Loss = Annotated[float, Field(ge=0, le=100)]
Place = Annotated[list[Metres], Field(min_length=2, max_length=2)]
Size = Annotated[float, Field(gt=0, le=10_000)]
Bound = Annotated[float, Field(gt=0, le=100)]


class DraftBeacon(StrictModel):
    """A beacon that may hang nowhere yet; what is left out is as for the whole plan."""

    id: Name | None = None
    x: Metres
    y: Metres
    z: Metres | None = None
    ref_level_dbm: Level | None = None
    path_loss_exponent: Exponent | None = None
    noise_db: Decibels | None = None


class DraftWall(StrictModel):
    """A wall as a line of corners, with its loss or its material."""

    line: Annotated[list[Place], Field(min_length=2, max_length=1_000)]
    attenuation_db: Loss | None = None
    material: str | None = None


class PlanFields(StrictModel):
    """The conditions of a plan, and what to look for."""

    noise_db: Annotated[
        Decibels | None, Field(description="Standard deviation of one level; else the beacons'")
    ] = None
    path_loss_exponent: Annotated[Exponent | None, Field(description="Else the beacons'")] = None
    ref_level_dbm: Annotated[Level | None, Field(description="At 1 m; else the beacons'")] = None
    epochs: Annotated[
        int, Field(ge=2, le=10_000, description="Levels of each beacon in a window")
    ] = 28
    period_s: Annotated[float, Field(gt=0, le=60, description="Time between two of them")] = 0.07
    cell_m: Annotated[float, Field(ge=0.05, le=50, description="Edge of a cell")] = 0.5
    bound_m: Annotated[Bound, Field(description="Bound that `share_below` counts against")] = 2.0
    hearing_threshold_dbm: Annotated[Level, Field(description="Weakest level that is heard")] = (
        HearingParams().threshold_dbm
    )
    reach_m: Annotated[Size | None, Field(description="Beacons farther away do not count")] = None
    min_beacons: Annotated[
        int, Field(ge=1, le=10, description="Where fewer are heard there is no fix")
    ] = 3
    phone_height_m: Annotated[Metres, Field(description="In the frame of the beacons' z")] = 0.0
    walls: Annotated[list[DraftWall] | None, Field(max_length=2_000)] = None
    materials: Annotated[
        dict[str, Loss] | None,
        Field(max_length=50, description="Loss of walls by material, dB, over the usual ones"),
    ] = None
    model: Annotated[
        Literal["static", "kinematic"], Field(description="Which error is to be bettered")
    ] = "static"
    drop_one: bool = False
    add: Annotated[int, Field(ge=0, le=20)] = 0
    cover_m: Bound | None = None


class FloorPlan(PlanFields):
    """A plan for a floor: of its registered beacons and the walls of its map, if none are given."""

    beacons: Annotated[list[DraftBeacon] | None, Field(max_length=MAX_BEACONS)] = None


class Layout(PlanFields):
    """A plan of its own, as a file: frame, beacons, and where it is on the globe, if known."""

    x0_m: Metres = 0.0
    y0_m: Metres = 0.0
    width_m: Size
    height_m: Size
    beacons: Annotated[list[DraftBeacon], Field(max_length=MAX_BEACONS)]
    control_points: Annotated[list[ControlPoint] | None, Field(min_length=2, max_length=200)] = None
