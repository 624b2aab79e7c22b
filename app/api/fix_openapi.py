"""The fix, and the replies that are made of fixes, in OpenAPI."""

from typing import Any

from app.core.types import Method, MotionMode
from app.services.tracks import TrackKind

Schema = dict[str, Any]

_NUMBER: Schema = {"type": "number"}
_TEXT: Schema = {"type": "string"}
_COUNT: Schema = {"type": "integer"}
_TIME: Schema = {"type": "string", "format": "date-time"}
_NULLABLE_TEXT: Schema = {"type": ["string", "null"]}

FIX: Schema = {
    "type": "object",
    "description": "Where a device was at one instant; metres in the site's frame.",
    "properties": {
        "device_id": {**_NULLABLE_TEXT, "description": "null in a one-shot answer"},
        "time": _TIME,
        "site_id": _TEXT,
        "floor_id": _TEXT,
        "x": _NUMBER,
        "y": _NUMBER,
        "lat": {**_NUMBER, "description": "WGS84; only at a site with a georeference."},
        "lon": {**_NUMBER, "description": "WGS84; only at a site with a georeference."},
        "radius95_m": {**_NUMBER, "description": "Predicted to hold the truth in 95 of 100 cases."},
        "covariance": {"type": "array", "items": {"type": "array", "items": _NUMBER}},
        "speed_mps": _NUMBER,
        "heading_deg": {"type": ["number", "null"], "description": "Clockwise from north."},
        "motion": {"enum": [mode.value for mode in MotionMode]},
        "method": {"enum": [method.value for method in Method]},
        "profile": _TEXT,
        "floor_confidence": _NUMBER,
        "zones": {"type": "array", "items": _TEXT},
        "used": {
            "type": "object",
            "description": "Transmitters of the newest scan, and steps since that scan.",
            "properties": {"beacons": _COUNT, "access_points": _COUNT, "steps": _COUNT},
        },
        "age_s": {
            **_NUMBER,
            "description": "Since the last observation that told the place; before a session's"
            " first, in its stored track, until that.",
        },
    },
    "required": ["device_id", "time", "site_id", "floor_id", "x", "y", "radius95_m"],
}

_FIX: Schema = {"$ref": "#/components/schemas/Fix"}

NULLABLE_FIX: Schema = {"oneOf": [_FIX, {"type": "null"}]}
NO_FIX: Schema = {
    "type": "object",
    "description": "Beside a fix that is null: why.",
    "properties": {"reason": _TEXT, "time": _NULLABLE_TEXT},
    "required": ["reason"],
}

_PAGE: Schema = {
    "type": "object",
    "properties": {
        "items": {"type": "array", "items": _FIX},
        "next_cursor": {**_NULLABLE_TEXT, "description": "null on the last page"},
    },
    "required": ["items", "next_cursor"],
}

_SESSIONS: Schema = {
    "type": "array",
    "description": "The sessions that the page's points are of.",
    "items": {
        "type": "object",
        "properties": {
            "session": {**_TEXT, "description": "The phone's name for it."},
            "kind": {
                "enum": [kind.value for kind in TrackKind],
                "description": "smoothed: of all that the session told; causal: as it was known",
            },
            "first": _TIME,
            "last": _TIME,
            "points": _COUNT,
        },
        "required": ["session", "kind", "first", "last", "points"],
    },
}

_TRACK_PAGE: Schema = {
    **_PAGE,
    "properties": {**_PAGE["properties"], "sessions": _SESSIONS},
    "required": [*_PAGE["required"], "sessions"],
}


def _json(description: str, schema: Schema) -> Schema:
    return {"description": description, "content": {"application/json": {"schema": schema}}}


FIXES_REPLY = _json("One fix of each device.", _PAGE)
TRACK_REPLY: Schema = {
    "description": "A page of the track, in the form that Accept asks for.",
    "content": {
        "application/json": {"schema": _TRACK_PAGE},
        "application/geo+json": {
            "schema": {"type": "object", "description": "A FeatureCollection (RFC 7946)."}
        },
        "text/csv": {"schema": _TEXT},
        "application/gpx+xml": {"schema": _TEXT},
    },
}
