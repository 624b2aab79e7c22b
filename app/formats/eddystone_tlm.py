"""Eddystone-TLM frames: what a beacon tells of its battery and temperature.

Source: Eddystone protocol specification, "Eddystone-TLM (unencrypted)", big-endian: frame type
0x20, version 0x00, battery voltage (u16, mV, 0: not told), temperature (s16, 8.8 fixed point, °C,
-128: not told), count of advertisements (u32), time since start (u32, 0.1 s).
"""

import struct

from app.core.types import BeaconTelemetry

NO_TEMPERATURE_DEGC = -128.0

_FRAME = struct.Struct(">BBHhII")
_TLM = 0x20
_PLAIN = 0x00
_NOT_TOLD = -0x8000


def tlm_telemetry(keys: tuple[str, ...], frame: str) -> BeaconTelemetry | None:
    """Return what a frame given in hexadecimal tells; None of an encrypted one, or of nothing told.

    Raises
    ------
    ValueError
        If it is not a TLM frame.
    """
    try:
        content = bytes.fromhex(frame)
    except ValueError:
        content = b""
    if len(content) < 2 or content[0] != _TLM:
        msg = "not an Eddystone-TLM frame in hexadecimal, which begins with 20"
        raise ValueError(msg)
    if content[1] != _PLAIN:
        return None
    if len(content) != _FRAME.size:
        msg = f"an Eddystone-TLM frame has {_FRAME.size} bytes, not {len(content)}"
        raise ValueError(msg)
    _, _, battery_mv, temperature, _, _ = _FRAME.unpack(content)
    battery_v = battery_mv / 1000.0 if battery_mv else None
    temperature_degc = None if temperature == _NOT_TOLD else temperature / 256.0
    if battery_v is None and temperature_degc is None:
        return None
    return BeaconTelemetry(keys, None, battery_v, temperature_degc)
