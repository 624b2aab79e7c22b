"""The affine fit of a site frame to the globe."""

import math

import pytest

from app.core.georeference import ControlPoint, fit_georeference

# A building of 65.1 m by 10.7 m given as a unit square.
UNIT_SQUARE = [
    ControlPoint(0, 0, 48.130216, 7.815694),
    ControlPoint(0, 1, 48.13031, 7.8157249),
    ControlPoint(1, 1, 48.130188, 7.816582),
    ControlPoint(1, 0, 48.130094, 7.816551),
]


def test_an_anisotropic_frame_is_fitted_to_millimetres() -> None:
    fit = fit_georeference(UNIT_SQUARE)
    assert fit.residual_rms_m < 0.003
    a, b, c, d = fit.matrix
    assert math.hypot(a, c) == pytest.approx(65.1, abs=0.2)
    assert math.hypot(b, d) == pytest.approx(10.7, abs=0.2)


def test_control_points_map_to_themselves() -> None:
    fit = fit_georeference(UNIT_SQUARE)
    for point in UNIT_SQUARE:
        lat_deg, lon_deg = fit.to_wgs84(point.x_m, point.y_m)
        assert lat_deg == pytest.approx(point.lat_deg, abs=5e-8)
        assert lon_deg == pytest.approx(point.lon_deg, abs=5e-8)


def test_two_points_give_rotation_scale_and_shift() -> None:
    # 1/8000 of a degree of latitude is 13.9 m: the frame's x axis points north.
    fit = fit_georeference(
        [ControlPoint(0, 0, 48.0, 8.0), ControlPoint(100, 0, 48.0 + 100 / 111_200.0, 8.0)]
    )
    lat_deg, lon_deg = fit.to_wgs84(0, 100)
    assert lat_deg == pytest.approx(48.0, abs=1e-6)
    assert lon_deg == pytest.approx(8.0 - 100 / (111_200.0 * math.cos(math.radians(48))), abs=1e-5)


@pytest.mark.parametrize(
    "points",
    [
        UNIT_SQUARE[:1],
        [UNIT_SQUARE[0], UNIT_SQUARE[0]],
        [ControlPoint(0, 0, 48, 8), ControlPoint(50, 0, 48, 8)],
        [ControlPoint(10.0 * i, 5.0 * i, 48 + 1e-4 * i, 8 + 1e-4 * i) for i in range(4)],
    ],
)
def test_points_that_span_nothing_are_refused(points: list[ControlPoint]) -> None:
    with pytest.raises(ValueError, match=r"control points|one line"):
        fit_georeference(points)


def test_a_place_goes_to_the_globe_and_back() -> None:
    points = [
        ControlPoint(0.0, 0.0, 52.5, 13.3),
        ControlPoint(60.0, 5.0, 52.5003, 13.3009),
        ControlPoint(-5.0, 40.0, 52.5004, 13.2997),
    ]
    georeference = fit_georeference(points)
    back = georeference.from_wgs84(*georeference.to_wgs84(17.0, -3.0))
    assert back == pytest.approx((17.0, -3.0), abs=1e-6)
