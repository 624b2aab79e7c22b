"""Where a survey's records lie: the floors they name, and frames turned into the site's.

Everything here refuses with `UnusableError`: one record less, never half a place.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from app.core.georeference import Georeference
from app.core.site import Floor

MARGIN_M = 10.0
"""A place this far outside its floor's plan is a wrong floor or frame, not an untidy plan."""

# What a phone can report: 0 and positive values mean "unknown", weaker than this none reports.
WEAKEST_DBM, STRONGEST_DBM = -127.0, -1.0

# Radius of the sphere of the web's Mercator projection (EPSG:3857).
_MERCATOR_RADIUS_M = 6_378_137.0


class UploadError(ValueError):
    """Nothing of an upload can be taken; the message says why."""


class Reason(StrEnum):
    """Why a line, record or file of an upload cannot be used; a few, so that they can be counted.

    Users see these words.
    """

    UNKNOWN_FLOOR = "unknown floor"
    OUTSIDE_PLAN = "outside the floor's plan"
    NO_GEOREFERENCE = "the site has no georeference"
    NOT_ON_GLOBE = "not a place on the globe"
    NOT_A_NUMBER = "not a number"
    NOT_A_TIME = "not a time"
    LEVEL_OUT_OF_RANGE = "the level is not in -127..-1 dBm"
    BAD_NAME = "a name is too long or has control characters"
    FORMULA = "a name looks like a formula"
    UNREADABLE = "cannot be read"
    NOT_UTF8 = "not UTF-8"
    FIELD_COUNT = "not as many fields as the header"
    BAD_KIND = "the kind is neither wifi nor ble"
    TOO_MANY_READINGS = "too many readings at one point"
    NOTHING_HEARD = "nothing was heard"
    NO_WAYPOINT = "no usable waypoint"
    NO_SCAN = "no scan"
    TOO_LONG = "longer than a walk"
    UNKNOWN_FORMAT = "of no known format"
    NOT_OPENED = "encrypted, or packed by a method that is not opened"


class UnusableError(ValueError):
    """One line or record cannot be used; ``detail`` names the value."""

    def __init__(self, reason: Reason, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
        self.detail = detail[:200]


@dataclass(frozen=True, slots=True)
class Unusable:
    """A line or record that cannot be used: where it is, and why."""

    place: str
    reason: Reason
    detail: str = ""


@dataclass(frozen=True, slots=True)
class SurveyFrame:
    """The site that a survey belongs to.

    ``chosen_floor_id`` is the floor of all of it, whatever it says itself.
    """

    floors: tuple[Floor, ...]
    georeference: Georeference | None = None
    chosen_floor_id: str | None = None

    def floor(self, name: str, building: str = "") -> Floor:
        """Return the floor of an id, name or level number; the building decides between several."""
        if self.chosen_floor_id is not None:
            return self._by_id(self.chosen_floor_id)
        wanted = name.strip().casefold()
        if not wanted and len(self.floors) == 1:
            return self.floors[0]
        named = [floor for floor in self.floors if wanted in _names(floor)]
        if len(named) > 1:
            named = [floor for floor in named if floor.building == building.strip()]
        if len(named) != 1:
            known = ", ".join(f"{floor.floor_id} ({floor.name})" for floor in self.floors[:20])
            raise UnusableError(Reason.UNKNOWN_FLOOR, f"{name!r} is not one of: {known}")
        return named[0]

    def place(self, floor: Floor, x_m: float, y_m: float) -> tuple[float, float]:
        """Return a place of the site frame, which has to be on the floor's plan or near it."""
        inside_x = -MARGIN_M <= x_m - floor.x0_m <= floor.width_m + MARGIN_M
        inside_y = -MARGIN_M <= y_m - floor.y0_m <= floor.height_m + MARGIN_M
        if not (inside_x and inside_y):
            raise UnusableError(Reason.OUTSIDE_PLAN, f"({x_m:.6g}, {y_m:.6g}) m")
        return x_m, y_m

    def plan_place(self, floor: Floor, x_m: float, y_m: float) -> tuple[float, float]:
        """Return a place in the frame of the floor's own plan (origin at its lower left corner)."""
        return self.place(floor, x_m + floor.x0_m, y_m + floor.y0_m)

    def globe_place(self, floor: Floor, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return a place given by latitude and longitude."""
        if self.georeference is None:
            raise UnusableError(Reason.NO_GEOREFERENCE)
        if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
            raise UnusableError(Reason.NOT_ON_GLOBE, f"{lat_deg:.6g}, {lon_deg:.6g}")
        return self.place(floor, *self.georeference.from_wgs84(lat_deg, lon_deg))

    def mercator_place(self, floor: Floor, x_m: float, y_m: float) -> tuple[float, float]:
        """Return a place given in metres of the web's Mercator projection (EPSG:3857).

        ``lon = x / R``, ``lat = 2 atan(exp(y / R)) - pi / 2``.
        """
        if not max(abs(x_m), abs(y_m)) <= math.pi * _MERCATOR_RADIUS_M:
            raise UnusableError(Reason.NOT_ON_GLOBE, f"{x_m:.6g}, {y_m:.6g}")
        lon_deg = math.degrees(x_m / _MERCATOR_RADIUS_M)
        lat_rad = 2.0 * math.atan(math.exp(y_m / _MERCATOR_RADIUS_M)) - math.pi / 2.0
        return self.globe_place(floor, math.degrees(lat_rad), lon_deg)

    def _by_id(self, floor_id: str) -> Floor:
        return next(floor for floor in self.floors if floor.floor_id == floor_id)


def _names(floor: Floor) -> tuple[str, ...]:
    return floor.floor_id.casefold(), floor.name.casefold(), str(floor.ordinal)


def number(text: object, what: str) -> float:
    """Return a finite number; ``what`` names it."""
    try:
        value = float(text)  # type: ignore[arg-type]  # anything that float takes
    except (TypeError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise UnusableError(Reason.NOT_A_NUMBER, f"{what} {text!r}")
    return value


def surveyed_level(text: object) -> float:
    """Return a level that a phone can have reported."""
    rssi_dbm = number(text, "the level")
    if not WEAKEST_DBM <= rssi_dbm <= STRONGEST_DBM:
        raise UnusableError(Reason.LEVEL_OUT_OF_RANGE, repr(text))
    return rssi_dbm


def plain_name(text: str) -> str:
    """Return a name that no spreadsheet would take for a formula, of plain characters."""
    name = text.strip()
    if len(name) > 200 or not name.isprintable():
        raise UnusableError(Reason.BAD_NAME, repr(name[:50]))
    if name[:1] in {"=", "+", "-", "@"} and not _is_number(name):
        raise UnusableError(Reason.FORMULA, repr(name))
    return name


def _is_number(text: str) -> bool:
    return text[1:].replace(".", "", 1).isascii() and text[1:].replace(".", "", 1).isdigit()
