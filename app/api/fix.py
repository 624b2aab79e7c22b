"""The fix, everywhere the same: one JSON shape for replies, reads and streams."""

import math
from datetime import UTC, datetime
from typing import Any

from app.core.geometry import wrap_angle
from app.core.georeference import Georeference
from app.core.types import NoFix, Output, TrackPoint

Json = dict[str, Any]


def iso_time(time_s: float) -> str:
    """Return an instant as RFC 3339 in UTC, to the millisecond."""
    instant = datetime.fromtimestamp(time_s, UTC)
    return instant.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def heading_deg_of(point: TrackPoint, georeference: Georeference | None) -> float | None:
    """Return the compass heading of a point: degrees clockwise from north.

    The point's own is counter-clockwise from the plan's +x; without georeference that is east.
    """
    if point.heading_rad is None:
        return None
    x_axis_rad = 0.0 if georeference is None else georeference.x_axis_from_east_rad
    compass_rad = wrap_angle(math.pi / 2.0 - (point.heading_rad + x_axis_rad))
    return round(math.degrees(compass_rad) % 360.0, 2) % 360.0


def fix_json(
    device_id: str | None,
    site_id: str,
    point: TrackPoint,
    georeference: Georeference | None = None,
) -> Json:
    """Return the JSON of a track point; ``age_s`` is as of the point's own time.

    ``lat`` and ``lon`` are there when the site is on the globe.
    """
    xx, xy, yy = point.covariance_m2
    fix: Json = {
        "device_id": device_id,
        "time": iso_time(point.time_s),
        "site_id": site_id,
        "floor_id": point.floor_id,
        "x": point.x_m,
        "y": point.y_m,
        "radius95_m": point.radius95_m,
        "covariance": [[xx, xy], [xy, yy]],
        "speed_mps": point.speed_mps,
        "heading_deg": heading_deg_of(point, georeference),
        "motion": point.motion.value,
        "method": point.method.value,
        "profile": point.profile,
        "floor_confidence": point.floor_confidence,
        "zones": list(point.zones),
        "used": {
            "beacons": point.used.beacons,
            "access_points": point.used.access_points,
            "steps": point.used.steps,
        },
        "age_s": point.age_s,
    }
    if georeference is not None:
        fix["lat"], fix["lon"] = georeference.to_wgs84(point.x_m, point.y_m)
    return fix


def output_json(
    device_id: str | None,
    site_id: str,
    output: Output | None,
    georeference: Georeference | None = None,
) -> Json:
    """Return ``{"fix": ...}``, and beside an absent fix ``{"no_fix": {"reason": ...}}``."""
    if isinstance(output, TrackPoint):
        return {"fix": fix_json(device_id, site_id, output, georeference)}
    if isinstance(output, NoFix):
        return {
            "fix": None,
            "no_fix": {"reason": output.reason.value, "time": iso_time(output.time_s)},
        }
    return {"fix": None, "no_fix": {"reason": "nothing_observed", "time": None}}


def report_json(
    device_id: str, site_id: str, output: Output, georeference: Georeference | None = None
) -> Json:
    """Return what live streams tell of a device: its fix, or why it has none."""
    if isinstance(output, TrackPoint):
        return fix_json(device_id, site_id, output, georeference)
    return {
        "device_id": device_id,
        "time": iso_time(output.time_s),
        "site_id": site_id,
        "no_fix": {"reason": output.reason.value},
    }
