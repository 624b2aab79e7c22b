"""A track as CSV, GeoJSON (RFC 7946) and GPX 1.1; the last two need a site on the globe."""

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import Any
from xml.etree import ElementTree as ET

from app.api.fix import heading_deg_of, iso_time
from app.core.georeference import Georeference
from app.formats.separated_values import text_cell
from app.services.errors import AppError, ErrorCode
from app.services.tracks import SitePoint

COLUMNS = (
    "time",
    "device_id",
    "site_id",
    "floor_id",
    "x",
    "y",
    "lat",
    "lon",
    "radius95_m",
    "speed_mps",
    "heading_deg",
    "motion",
    "method",
    "floor_confidence",
    "kind",
)

GPX_NAMESPACE = "http://www.topografix.com/GPX/1/1"

GeoreferenceOf = Callable[[str], Georeference | None]


def track_csv(points: Iterable[SitePoint], georeference_of: GeoreferenceOf) -> str:
    """Return one row a point; lat and lon are empty where the site is not on the globe."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for located in points:
        point = located.point
        georeference = georeference_of(located.site_id)
        lat_lon = ("", "") if georeference is None else georeference.to_wgs84(point.x_m, point.y_m)
        writer.writerow(
            (
                iso_time(point.time_s),
                text_cell(located.device_id),
                located.site_id,
                point.floor_id,
                point.x_m,
                point.y_m,
                *lat_lon,
                point.radius95_m,
                point.speed_mps,
                heading_deg_of(point, georeference),
                point.motion.value,
                point.method.value,
                point.floor_confidence,
                located.kind.value,
            )
        )
    return out.getvalue()


def track_geojson(
    points: Sequence[SitePoint], georeference_of: GeoreferenceOf, next_cursor: str | None
) -> dict[str, Any]:
    """Return a FeatureCollection: one line for each stretch on one floor in one session."""
    features = [
        _feature(list(stretch), georeference_of)
        for _, stretch in groupby(points, key=lambda p: (p.session_id, p.point.floor_id, p.kind))
    ]
    return {"type": "FeatureCollection", "features": features, "next_cursor": next_cursor}


def track_gpx(points: Sequence[SitePoint], georeference_of: GeoreferenceOf) -> bytes:
    """Return a GPX document: one track, a segment for each stretch on one floor."""
    root = ET.Element("gpx", {"version": "1.1", "creator": "Pharos", "xmlns": GPX_NAMESPACE})
    track = ET.SubElement(root, "trk")
    if points:
        ET.SubElement(track, "name").text = points[0].device_id
    for _, stretch in groupby(points, key=lambda p: (p.session_id, p.point.floor_id)):
        segment = ET.SubElement(track, "trkseg")
        for located in stretch:
            lat_deg, lon_deg = _lat_lon(located, georeference_of)
            attributes = {"lat": f"{lat_deg:.8f}", "lon": f"{lon_deg:.8f}"}
            place = ET.SubElement(segment, "trkpt", attributes)
            ET.SubElement(place, "time").text = iso_time(located.point.time_s)
    document: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return document


def _feature(stretch: Sequence[SitePoint], georeference_of: GeoreferenceOf) -> dict[str, Any]:
    places = [_lat_lon(located, georeference_of) for located in stretch]
    coordinates = [[round(lon_deg, 8), round(lat_deg, 8)] for lat_deg, lon_deg in places]
    # A line has at least two positions.
    single = len(coordinates) == 1
    geometry = {
        "type": "Point" if single else "LineString",
        "coordinates": coordinates[0] if single else coordinates,
    }
    first = stretch[0]
    properties = {
        "device_id": first.device_id,
        "site_id": first.site_id,
        "floor_id": first.point.floor_id,
        "kind": first.kind.value,
        "times": [iso_time(located.point.time_s) for located in stretch],
        "radius95_m": [located.point.radius95_m for located in stretch],
    }
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _lat_lon(located: SitePoint, georeference_of: GeoreferenceOf) -> tuple[float, float]:
    georeference = georeference_of(located.site_id)
    if georeference is None:
        detail = f"site {located.site_id!r} has no georeference; ask for JSON or CSV"
        raise AppError(ErrorCode.NO_GEOREFERENCE, detail)
    return georeference.to_wgs84(located.point.x_m, located.point.y_m)
