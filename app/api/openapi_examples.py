"""One request of every operation that takes JSON; in this order they build up a small site."""

import math
from typing import Any

Example = dict[str, Any]


def _levels(beacon_id: str, x_m: float, y_m: float) -> list[Example]:
    """Return what a phone hears of a beacon of -61 dBm and exponent 2.3, every 3 m around it."""
    places = [(x_m + 3.0 * i, y_m + 3.0 * j) for i in range(7) for j in range(-3, 4)]
    return [
        {
            "x": x,
            "y": y,
            "rssi_dbm": round(-61.0 - 23.0 * math.log10(math.hypot(x - x_m, y - y_m, 2.4)), 1),
            "beacon_id": beacon_id,
            "device_id": "phone-7",
        }
        for x, y in places
    ]


EXAMPLES: dict[tuple[str, str], Example] = {
    ("post", "/v1/login"): {"token": "pharos_as-the-server-printed-it"},
    ("post", "/v1/sites"): {"site_id": "hall", "name": "Hall", "retention_days": 30},
    ("put", "/v1/sites/{site_id}"): {"name": "Hall 2", "retention_days": None},
    ("patch", "/v1/sites/{site_id}"): {"name": "Hall 3"},
    ("put", "/v1/sites/{site_id}/georeference"): {
        "control_points": [
            {"x": 0, "y": 0, "lat": 52.51627, "lon": 13.37770},
            {"x": 60, "y": 0, "lat": 52.51627, "lon": 13.37858},
            {"x": 60, "y": 40, "lat": 52.51663, "lon": 13.37858},
        ]
    },
    ("post", "/v1/floors"): {
        "floor_id": "hall-0",
        "site_id": "hall",
        "name": "Ground floor",
        "ordinal": 0,
        "width": 60,
        "height": 40,
    },
    ("put", "/v1/floors/{floor_id}"): {
        "name": "Ground floor",
        "building": "North",
        "ordinal": 0,
        "x0": -2,
        "y0": -2,
        "width": 64,
        "height": 44,
    },
    ("patch", "/v1/floors/{floor_id}"): {"name": "Street level"},
    ("put", "/v1/floors/{floor_id}/map"): {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"kind": "walkable"},
                "geometry": {
                    "type": "Polygon",
                    "coordinates": [[[0, 0], [60, 0], [60, 40], [0, 40], [0, 0]]],
                },
            },
            {
                "type": "Feature",
                "properties": {"kind": "wall", "attenuation_db": 8},
                "geometry": {"type": "LineString", "coordinates": [[20, 0], [20, 15]]},
            },
        ],
    },
    ("post", "/v1/floors/{floor_id}/map/features"): {
        "type": "Feature",
        "id": "meeting-room",
        "properties": {"kind": "wall", "material": "glass"},
        "geometry": {"type": "LineString", "coordinates": [[20, 15], [30, 15], [30, 0]]},
    },
    ("patch", "/v1/floors/{floor_id}/map/features/{feature_id}"): {
        "properties": {"material": "brick"}
    },
    ("post", "/v1/radio-maps"): {"site_id": "hall", "name": "Spring", "virtual": True},
    ("post", "/v1/beacons"): {
        "beacon_id": "entrance",
        "site_id": "hall",
        "kind": "ble",
        "keys": ["ibeacon:f7826da6-4fa2-4e98-8024-bc5b71e0893e:1:7", "mac:c2007d0000aa"],
        "floor_id": "hall-0",
        "x": 3.5,
        "y": 12,
        "z": 2.4,
        "ref_level_dbm": -61,
    },
    ("post", "/v1/floors/{floor_id}/predicted-accuracy"): {
        "beacons": [{"x": 3.5, "y": 12}, {"x": 56, "y": 4}, {"x": 30, "y": 36}],
        "noise_db": 5,
        "path_loss_exponent": 2,
        "epochs": 28,
        "period_s": 0.07,
        "cell_m": 1,
        "bound_m": 3,
        "materials": {"glass": 2.5},
        "drop_one": True,
        "add": 1,
    },
    ("put", "/v1/beacons/{beacon_id}"): {
        "kind": "ble",
        "keys": ["mac:c2007d0000aa"],
        "floor_id": "hall-0",
        "x": 3.5,
        "y": 12.2,
    },
    ("patch", "/v1/beacons/{beacon_id}"): {"shadowing_db": 4.2, "path_loss_exponent": 2.3},
    ("post", "/v1/beacons/import"): {
        "items": [
            {
                "beacon_id": "stairs",
                "kind": "wifi",
                "keys": ["mac:0242ac110001"],
                "floor_id": "hall-0",
                "x": 40,
                "y": 8,
            }
        ]
    },
    ("post", "/v1/surveys/uploads"): {"site_id": "hall", "name": "May", "total_bytes": 1000},
    ("post", "/v1/surveys/from-session"): {"device_id": "phone-7", "name": "Ground floor"},
    ("patch", "/v1/surveys/{survey_id}"): {"name": "Ground floor, May"},
    ("patch", "/v1/beacons"): {
        "items": [
            {"beacon_id": "entrance", "patch": {"z": 2.4}},
            {"beacon_id": "stairs", "etag": '"1"', "patch": {"name": "Stairs, ground floor"}},
        ]
    },
    ("post", "/v1/floors/{floor_id}/calibration"): {"levels": _levels("entrance", 3.5, 12.2)},
    ("post", "/v1/floors/{floor_id}/beacon-places"): {
        "levels": _levels("stairs", 38.0, 8.0),
        "beacon_ids": ["stairs"],
    },
    ("post", "/v1/tokens"): {
        "name": "Phones of the hall",
        "role": "device",
        "site_id": "hall",
        "device_prefix": "hall-",
        "expires": "2035-12-31T23:59:59Z",
    },
    ("patch", "/v1/devices/{device_id}"): {
        "name": "Forklift 3",
        "person": "Ada",
        "level_offset_db": -2,
        "profile": "best",
    },
    ("post", "/v1/devices/{device_id}/replay"): {"profile": "best"},
}


def add_examples(document: dict[str, Any]) -> None:
    """Put the examples beside the bodies that they are of."""
    for (method, path), example in EXAMPLES.items():
        content = document["paths"][path][method]["requestBody"]["content"]
        json_type = next(media_type for media_type in content if media_type.endswith("json"))
        content[json_type]["example"] = example
