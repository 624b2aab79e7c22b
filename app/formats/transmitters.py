"""Canonical transmitter keys: one spelling for each name that a beacon or access point goes by."""

import re

_HEX = re.compile(r"[0-9a-f]+")


def mac_key(mac: str) -> str:
    """Return ``mac:<12 hex>`` of a MAC in any usual spelling."""
    return f"mac:{_hex(mac, 12, 'a MAC', ':-.')}"


def ibeacon_key(uuid: str, major: int, minor: int) -> str:
    """Return ``ibeacon:<uuid>:<major>:<minor>``, the UUID in lower case with hyphens."""
    digits = _hex(uuid, 32, "a UUID", "-")
    for name, number in (("major", major), ("minor", minor)):
        if not 0 <= number <= 0xFFFF:
            msg = f"{name} {number} is not in 0..65535"
            raise ValueError(msg)
    parts = (digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:])
    return f"ibeacon:{'-'.join(parts)}:{major}:{minor}"


def eddystone_key(namespace: str, instance: str) -> str:
    """Return ``eddystone:<20 hex>:<12 hex>``."""
    return f"eddystone:{_hex(namespace, 20, 'a namespace')}:{_hex(instance, 12, 'an instance')}"


def altbeacon_key(identifier: str) -> str:
    """Return ``altbeacon:<40 hex>``."""
    return f"altbeacon:{_hex(identifier, 40, 'an AltBeacon identifier', '-')}"


def canonical_key(text: str) -> str:
    """Return the canonical spelling of a key; ValueError says what is wrong with it."""
    kind, _, rest = text.strip().partition(":")
    kind = kind.lower()
    if kind in {"mac", "bssid"}:
        return mac_key(rest)
    if kind == "altbeacon":
        return altbeacon_key(rest)
    parts = rest.split(":")
    if kind == "eddystone" and len(parts) == 2:
        return eddystone_key(*parts)
    if kind == "ibeacon" and len(parts) == 3:
        uuid, major, minor = parts
        return ibeacon_key(uuid, _integer(major), _integer(minor))
    msg = f"{text!r} is not mac:…, ibeacon:uuid:major:minor, eddystone:ns:instance or altbeacon:…"
    raise ValueError(msg)


def _integer(text: str) -> int:
    if not (text.isascii() and text.isdigit()):
        msg = f"{text!r} is not a whole number"
        raise ValueError(msg)
    return int(text)


def _hex(text: str, length: int, what: str, separators: str = "") -> str:
    digits = text.strip().lower().translate({ord(c): None for c in separators})
    if len(digits) != length or not _HEX.fullmatch(digits):
        msg = f"{text!r} is not {what} of {length} hexadecimal digits"
        raise ValueError(msg)
    return digits
