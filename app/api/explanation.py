"""Why a fix is what it is, as JSON and in OpenAPI."""

from typing import Any

from app.api.fix import Json, iso_time
from app.api.fix_openapi import NO_FIX, NULLABLE_FIX
from app.core.engine import Explanation
from app.core.engine.explanation import Use
from app.core.lateration.faults import Fault
from app.core.motion.mode import MotionEvidence
from app.core.types import Method, MotionMode


def explanation_json(explanation: Explanation) -> Json:
    """Return the JSON of an explanation; what it explains stands beside it."""
    gate, motion = explanation.gate, explanation.motion
    return {
        "means": None if explanation.means is None else explanation.means.value,
        "scan_time": None if explanation.scan_s is None else iso_time(explanation.scan_s),
        "candidates": [
            {
                "floor_id": place.floor_id,
                "x": place.x_m,
                "y": place.y_m,
                "weight": place.weight,
                "seen_weight": place.seen_weight,
            }
            for place in explanation.candidates
        ],
        "transmitters": [
            {
                "key": one.key,
                "kind": one.kind,
                "beacon_id": one.anchor_id,
                "heard_dbm": one.heard_dbm,
                "expected_dbm": one.expected_dbm,
                "residual_db": one.residual_db,
                "use": one.use.value,
            }
            for one in explanation.transmitters
        ],
        "level_offset_db": explanation.level_offset_db,
        "gate": None
        if gate is None
        else {
            "distance_m": gate.distance_m,
            "nis": gate.nis,
            "inlier_probability": gate.inlier_probability,
        },
        "floors": [
            {
                "floor_id": floor.floor_id,
                "vote_share": floor.vote_share,
                "probability": floor.probability,
            }
            for floor in explanation.floors
        ],
        "motion": {
            "mode": motion.mode.value,
            "decided_by": motion.decided_by.value,
            "since_step_s": motion.since_step_s,
            "acc_variance_m2ps4": motion.acc_variance_m2ps4,
            "velocity_chi2": motion.velocity_chi2,
        },
        "faults": [
            {"beacon_id": one.anchor_id, "kind": None if one.fault is None else one.fault.value}
            for one in explanation.faults
        ],
    }


Schema = dict[str, Any]

_TEXT: Schema = {"type": "string"}
_NUMBER: Schema = {"type": "number"}
_MAYBE_TEXT: Schema = {"type": ["string", "null"]}
_MAYBE_NUMBER: Schema = {"type": ["number", "null"]}


def _object(description: str, **properties: Schema) -> Schema:
    return {
        "type": "object",
        "description": description,
        "properties": properties,
        "required": list(properties),
    }


def _list(item: Schema) -> Schema:
    return {"type": "array", "items": item}


EXPLANATION: Schema = _object(
    "Why the fix beside it is what it is.",
    means={
        "enum": [*(method.value for method in Method), None],
        "description": "How the scan told the place; null: it told none.",
    },
    scan_time={**_MAYBE_TEXT, "description": "Of the newest scan that told the place."},
    candidates=_list(
        _object(
            "A place the scan spoke for: its weight by matching, and as the filter saw it.",
            floor_id=_TEXT,
            x=_NUMBER,
            y=_NUMBER,
            weight=_NUMBER,
            seen_weight=_NUMBER,
        )
    ),
    transmitters=_list(
        _object(
            "What was heard, what is expected at the told place, and what became of it.",
            key=_TEXT,
            kind={"enum": ["wifi", "ble"]},
            beacon_id=_MAYBE_TEXT,
            heard_dbm=_NUMBER,
            expected_dbm=_MAYBE_NUMBER,
            residual_db={**_MAYBE_NUMBER, "description": "Heard less expected."},
            use={"enum": [use.value for use in Use]},
        )
    ),
    level_offset_db={**_MAYBE_NUMBER, "description": "Median residual of those used."},
    gate={
        "oneOf": [
            _object(
                "The scan against the filter's prediction: chi-square with 2 degrees of freedom,"
                " and the share of its information that was taken.",
                distance_m=_NUMBER,
                nis=_NUMBER,
                inlier_probability=_MAYBE_NUMBER,
            ),
            {"type": "null"},
        ]
    },
    floors=_list(
        _object(
            "The scan's vote for a floor, and its probability.",
            floor_id=_TEXT,
            vote_share=_MAYBE_NUMBER,
            probability=_MAYBE_NUMBER,
        )
    ),
    motion=_object(
        "The motion mode and what decided it.",
        mode={"enum": [mode.value for mode in MotionMode]},
        decided_by={"enum": [evidence.value for evidence in MotionEvidence]},
        since_step_s=_MAYBE_NUMBER,
        acc_variance_m2ps4=_MAYBE_NUMBER,
        velocity_chi2=_MAYBE_NUMBER,
    ),
    faults=_list(
        _object(
            "A beacon that the fix does not rest on, since it is more likely at fault than not.",
            beacon_id=_TEXT,
            kind={
                "enum": [*(fault.value for fault in Fault), None],
                "description": "Null: that something is wrong is clear, but not yet what.",
            },
        )
    ),
)

EXPLAINED_FIX_REPLY: Schema = {
    "description": "Where the device is, or why that is not known; explained if asked.",
    "content": {
        "application/json": {
            "schema": {
                "type": "object",
                "properties": {
                    "fix": NULLABLE_FIX,
                    "no_fix": NO_FIX,
                    "explanation": {
                        "oneOf": [
                            {"$ref": "#/components/schemas/Explanation"},
                            {"type": "null"},
                        ],
                        "description": "With `explain`; null when the session is over.",
                    },
                },
                "required": ["fix"],
            }
        }
    },
}
