"""Accuracy does not drift: a small part is measured again and compared with what was written down.

A figure that got better by more than the bound fails too: write the new ones down, see
`seeded_part`.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from seeded_part import BASELINE, recorded, simulated

DRIFT = 0.05


def flat(figures: dict[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in figures.items():
        if isinstance(value, dict):
            yield from ((f"{name}.{inner}", each) for inner, each in flat(value))
        else:
            yield name, value


def compare(part: str, found: dict[str, Any]) -> None:
    expected = dict(flat(json.loads(BASELINE.read_text(encoding="utf-8"))[part]))
    assert dict(flat(found)) == pytest.approx(expected, rel=DRIFT)


def test_simulated_walks_are_followed_as_well_as_ever() -> None:
    compare("simulated", simulated())


def test_recorded_walks_are_followed_as_well_as_ever(shared_data: Path) -> None:
    compare("recorded", recorded(shared_data))


def test_a_drift_would_be_seen() -> None:
    written = json.loads(BASELINE.read_text(encoding="utf-8"))["simulated"]
    worse = {**written, "mean_error_m": 1.06 * written["mean_error_m"]}
    with pytest.raises(AssertionError):
        compare("simulated", worse)
