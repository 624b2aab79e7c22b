"""Eddystone-TLM frames: battery and temperature, and what is not told."""

import pytest

from app.core.types import BeaconTelemetry
from app.formats.eddystone_tlm import tlm_telemetry

KEYS = ("mac:a4c138000001",)


def frame(battery: str = "0bb8", temperature: str = "1580", version: str = "00") -> str:
    return f"20{version}{battery}{temperature}0000000a00000064"


@pytest.mark.parametrize(
    ("text", "battery_v", "temperature_degc"),
    [
        (frame(), 3.0, 21.5),
        (frame(temperature="fe80"), 3.0, -1.5),
        (frame(temperature="8000"), 3.0, None),
        (frame(battery="0000"), None, 21.5),
    ],
)
def test_a_frame_tells_battery_and_temperature(
    text: str, battery_v: float | None, temperature_degc: float | None
) -> None:
    expected = BeaconTelemetry(KEYS, None, battery_v, temperature_degc)
    assert tlm_telemetry(KEYS, text.upper()) == expected


@pytest.mark.parametrize("text", [frame("0000", "8000"), frame(version="01")])
def test_a_frame_may_tell_nothing(text: str) -> None:
    assert tlm_telemetry(KEYS, text) is None


@pytest.mark.parametrize("text", ["", "20", "10" + frame()[2:], frame()[:-2], frame() + "00", "xy"])
def test_another_frame_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="Eddystone-TLM"):
        tlm_telemetry(KEYS, text)
