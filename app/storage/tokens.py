"""Access tokens as stored: only their hash, with role, scope and times."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StoredToken:
    """One token; the secret itself is nowhere, only its SHA-256.

    Attributes
    ----------
    site_id
        The one site it is for; None: every site.
    device_id, device_prefix
        For the role ``device``: the one device, or the beginning of the ids it may enrol.
    """

    token_id: str
    name: str
    token_hash: bytes
    role: str
    created_s: float
    site_id: str | None = None
    device_id: str | None = None
    device_prefix: str | None = None
    expires_s: float | None = None
