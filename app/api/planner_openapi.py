"""The reply of the planner for the OpenAPI document."""

from typing import Any

Schema = dict[str, Any]

_NUMBER: Schema = {"type": "number"}
_INTEGER: Schema = {"type": "integer"}
_NULLABLE: Schema = {"type": ["number", "null"]}

_FIGURES: Schema = {
    "min": {**_NULLABLE, "description": "Metres; null: there is no fix anywhere"},
    "median": _NULLABLE,
    "max": {**_NULLABLE, "description": "null: there is no fix in some cells"},
    "share_below": {**_NUMBER, "description": "Share of the floor at or below `bound_m`"},
    "mean_variance_m2": {**_NULLABLE, "description": "Mean of trace D over the floor"},
}
_GRID: Schema = {"type": "array", "items": {"type": "array", "items": _NULLABLE}}
_BEACON: Schema = {"id": {"type": "string"}, "x": _NUMBER, "y": _NUMBER}


def _object(properties: Schema) -> Schema:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _or_null(schema: Schema) -> Schema:
    return {"oneOf": [schema, {"type": "null"}]}


def _list(properties: Schema) -> Schema:
    return {"type": "array", "items": _object(properties)}


_PLAN: Schema = _object(
    {
        "x0_m": _NUMBER,
        "y0_m": _NUMBER,
        "cell_m": _NUMBER,
        "rows": _INTEGER,
        "columns": _INTEGER,
        "cells": {**_INTEGER, "description": "Cells of the floor that people walk on"},
        "bound_m": _NUMBER,
        "beacons": _list(_BEACON),
        "static": _object({**_FIGURES, "grid": _GRID}),
        "kinematic": _object({**_FIGURES, "grid": _GRID}),
        "in_range": _object(
            {
                "min": _INTEGER,
                "median": _NUMBER,
                "max": _INTEGER,
                "share_three_or_more": _NUMBER,
                "grid": _GRID,
            }
        ),
        "drop_one": _or_null(_list({**_BEACON, **_FIGURES})),
        "add": _or_null(_list({**_BEACON, **_FIGURES})),
        "cover": _or_null(
            _object(
                {
                    "bound_m": _NUMBER,
                    "reached": {"type": "boolean"},
                    "beacons": _list(_BEACON),
                    **_FIGURES,
                }
            )
        ),
    }
)

PLAN_REPLY: Schema = {
    "description": "The predicted error, in the form that Accept asks for.",
    "content": {
        "application/json": {"schema": _PLAN},
        "application/geo+json": {
            "schema": {
                "type": "object",
                "description": "A FeatureCollection (RFC 7946): a polygon per cell, the beacons.",
            }
        },
        "image/png": {"schema": {"type": "string", "format": "binary"}},
    },
}
