"""Reference points: the survey scans of a cell, cleaned."""

import pytest

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.fingerprint.reference_points import (
    ReferencePointParams,
    ReferencePoints,
    reference_points,
)
from app.core.fingerprint.virtual import VIRTUAL_WALK

PARAMS = ReferencePointParams()


@pytest.fixture(scope="module")
def points() -> ReferencePoints:
    levels_dbm = (-60.0, -60.0, -60.0, -60.0, -80.0)
    scans = [Fingerprint(0, 4.0 + 0.1 * i, 1.0, {}, {"b": u}) for i, u in enumerate(levels_dbm)]
    return reference_points(
        build_radio_map(
            ("ground", "upper"),
            [
                Fingerprint(1, 1.0, 1.0, {"w": -70.0}, {}),
                *scans,
                Fingerprint(0, 5.0, 1.0, {"w": -50.0}, {}),
                Fingerprint(0, 4.0, 1.0, {"w": -20.0}, {}, VIRTUAL_WALK),
            ],
        ),
        PARAMS,
    )


def test_a_point_stands_where_its_scans_were_made(points: ReferencePoints) -> None:
    assert points.floor_index.tolist() == [0, 1]
    assert points.scans.tolist() == [6, 1]
    assert points.x_m == pytest.approx([26.0 / 6.0, 1.0])
    assert points.y_m == pytest.approx([1.0, 1.0])


def test_its_levels_are_cleaned_and_virtual_ones_left_out(points: ReferencePoints) -> None:
    levels = points.levels
    # Columns in order of appearance: w, b.
    assert list(zip(levels.point.tolist(), levels.transmitter.tolist(), strict=True)) == [
        (0, 0),
        (0, 1),
        (1, 0),
    ]
    assert levels.mean_dbm.tolist() == [-50.0, -60.0, -70.0]
    assert levels.count.tolist() == [1, 5, 1]
    assert levels.heard_share == pytest.approx([1.0 / 6.0, 5.0 / 6.0, 1.0])
