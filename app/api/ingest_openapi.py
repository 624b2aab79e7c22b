"""The ingest and locate bodies in OpenAPI, made from the structs that decode them."""

from typing import Any

import msgspec

from app.api.fix_openapi import NO_FIX, NULLABLE_FIX
from app.api.ingest_schema import RECORD_TYPES, Batch, LocateBody

Schema = dict[str, Any]

_TEMPLATE = "#/components/schemas/{name}"
_RECORDS = tuple(RECORD_TYPES.values())


def _components() -> Schema:
    _, schemas = msgspec.json.schema_components(
        [Batch, LocateBody, *_RECORDS], ref_template=_TEMPLATE
    )
    names = {kind: model.__name__ for kind, model in RECORD_TYPES.items()}
    schemas["Record"] = {
        "description": "One record. Other kinds (`rtt`, `fix`, ...) are counted as ignored.",
        "oneOf": [_ref(name) for name in names.values()],
        "discriminator": {
            "propertyName": "k",
            "mapping": {kind: _ref(name)["$ref"] for kind, name in names.items()},
        },
    }
    for body in (Batch, LocateBody):
        # Each record is decoded on its own, which the structs cannot say.
        schemas[body.__name__]["properties"]["records"]["items"] = _ref("Record")
    return schemas


def _ref(name: str) -> Schema:
    return {"$ref": _TEMPLATE.format(name=name)}


COMPONENTS: Schema = _components()

WIFI_EXAMPLE: Schema = {
    "device": {"id": "phone-7", "platform": "android", "model": "Pixel 8", "app": "1.4.0"},
    "session": "6f1c2f0e-walk-1",
    "seq": 0,
    "clock": {"mode": "live"},
    "records": [
        {
            "k": "wifi",
            "t_ms": 1795314000000,
            "aps": [
                {"bssid": "02:42:ac:11:00:01", "rssi": -48, "freq": 2412, "age_ms": 120},
                {"bssid": "0242ac110002", "rssi": -67, "freq": 5180, "age_ms": 900},
            ],
        },
        {
            "k": "ble",
            "t_ms": 1795314000100,
            "beacons": [
                {
                    "ibeacon": {
                        "uuid": "f7826da6-4fa2-4e98-8024-bc5b71e0893e",
                        "major": 1,
                        "minor": 7,
                    },
                    "mac": "c2:00:7d:00:00:aa",
                    "rssi": -71,
                    "tx1m": -59,
                }
            ],
        },
    ],
}

MOTION_EXAMPLE: Schema = {
    "device": {"id": "phone-8", "platform": "ios"},
    "session": "b0c1a9d2-walk-2",
    "seq": 0,
    "clock": {"mode": "live"},
    "records": [
        {"k": "step", "t_ms": 1795314000200, "len_m": 0.71, "heading_deg": 84.0},
        {
            "k": "pedometer",
            "t0_ms": 1795313990000,
            "t1_ms": 1795314000000,
            "steps": 9,
            "dist_m": 6.6,
        },
        {
            "k": "imu",
            "t0_ms": 1795313999960,
            "rate_hz": 50,
            "acc": [[0.1, 0.2, 9.8], [0.1, 0.3, 9.9]],
            "quat": [[1, 0, 0, 0], [1, 0, 0, 0]],
        },
        {"k": "baro", "t_ms": 1795314000300, "hpa": 1013.2},
    ],
}

LOCATE_EXAMPLE: Schema = {"records": WIFI_EXAMPLE["records"]}


def _body(name: str, examples: dict[str, Schema]) -> Schema:
    content = {"schema": _ref(name), "examples": {k: {"value": v} for k, v in examples.items()}}
    return {"requestBody": {"required": True, "content": {"application/json": content}}}


INGEST_BODY = _body("Batch", {"scans": WIFI_EXAMPLE, "motion": MOTION_EXAMPLE})
LOCATE_BODY = _body("LocateBody", {"scans": LOCATE_EXAMPLE})

_REJECTED: Schema = {
    "type": "array",
    "items": {
        "type": "object",
        "properties": {
            "i": {"type": "integer"},
            "code": {"type": "string"},
            "pointer": {"type": "string"},
            "detail": {"type": "string"},
        },
        "required": ["i", "code", "pointer", "detail"],
    },
}


def _reply(description: str, properties: Schema) -> Schema:
    fields = {
        "rejected": _REJECTED,
        "ignored": {"type": "integer"},
        "fix": NULLABLE_FIX,
        "no_fix": NO_FIX,
        **properties,
    }
    required = [name for name in fields if name != "no_fix"]
    schema = {"type": "object", "properties": fields, "required": required}
    return {"description": description, "content": {"application/json": {"schema": schema}}}


INGEST_REPLY = _reply(
    "The batch is durable; `fix` is what it led to.",
    {
        "accepted": {"type": "integer"},
        "waiting": {
            "type": "integer",
            "description": "Of the accepted records, timed by a clock that no batch told so far.",
        },
        "duplicate": {"type": "boolean", "description": "The batch was known already."},
        "server_ms": {"type": "integer"},
    },
)
LOCATE_REPLY = _reply(
    "Where it was heard.",
    {
        "alternatives": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "floor_id": {"type": "string"},
                    "x": {"type": "number"},
                    "y": {"type": "number"},
                    "weight": {"type": "number"},
                },
            },
        }
    },
)
