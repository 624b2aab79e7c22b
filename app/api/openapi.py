"""The OpenAPI document: FastAPI's, with the ingest body, the fix, problems and bearer tokens."""

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.api.ingest_openapi import COMPONENTS
from app.core.types import Method, MotionMode
from app.services.errors import ErrorCode

_NUMBER = {"type": "number"}
_TEXT = {"type": "string"}
_COUNT = {"type": "integer"}

FIX: dict[str, Any] = {
    "type": "object",
    "description": "Where a device was at one instant; metres in the site's frame.",
    "properties": {
        "device_id": {"type": ["string", "null"], "description": "null in a one-shot answer"},
        "time": {"type": "string", "format": "date-time"},
        "site_id": _TEXT,
        "floor_id": _TEXT,
        "x": _NUMBER,
        "y": _NUMBER,
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
        "age_s": {**_NUMBER, "description": "Since the last observation that told the place."},
    },
    "required": ["device_id", "time", "site_id", "floor_id", "x", "y", "radius95_m"],
}

PROBLEM: dict[str, Any] = {
    "type": "object",
    "description": "RFC 9457 problem details.",
    "properties": {
        "type": _TEXT,
        "title": _TEXT,
        "status": _COUNT,
        "detail": _TEXT,
        "instance": _TEXT,
        "code": {"enum": [code.value for code in ErrorCode]},
        "errors": {
            "type": "array",
            "items": {"type": "object", "properties": {"pointer": _TEXT, "detail": _TEXT}},
        },
        "request_id": _TEXT,
    },
    "required": ["type", "title", "status", "detail", "code"],
}

_OPEN_PATHS = frozenset({"/healthz", "/readyz"})


def install_openapi(app: FastAPI) -> None:
    """Make ``app.openapi()`` return our document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # as FastAPI documents it


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas |= {**COMPONENTS, "Fix": FIX, "Problem": PROBLEM}
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    for path in _OPEN_PATHS & document["paths"].keys():
        for operation in document["paths"][path].values():
            operation["security"] = []
    return document
