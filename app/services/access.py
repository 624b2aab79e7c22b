"""Who asks and what they may: roles, and the scope of a token."""

from dataclasses import dataclass
from enum import StrEnum


class Role(StrEnum):
    """What a token is for."""

    ADMIN = "admin"
    SUPERVISOR = "supervisor"
    SURVEYOR = "surveyor"
    VIEWER = "viewer"
    DEVICE = "device"


READERS = (Role.ADMIN, Role.SUPERVISOR, Role.SURVEYOR, Role.VIEWER)


@dataclass(frozen=True, slots=True)
class Principal:
    """The bearer of a valid token.

    Attributes
    ----------
    site_id
        The one site the token is for; None: every site.
    device_id, device_prefix
        For the device role: the one device, or the beginning of the ids it may enrol.
    """

    token_id: str
    role: Role
    site_id: str | None = None
    device_id: str | None = None
    device_prefix: str | None = None

    def covers_site(self, site_id: str) -> bool:
        """Tell whether the token reaches a site."""
        return self.site_id is None or self.site_id == site_id

    def covers_device(self, device_id: str) -> bool:
        """Tell whether the token reaches a device; only the device role is limited."""
        if self.role is not Role.DEVICE:
            return True
        if self.device_id is not None:
            return self.device_id == device_id
        return self.device_prefix is not None and device_id.startswith(self.device_prefix)
