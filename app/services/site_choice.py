"""Which site and profile a request is about when it leaves that open."""

from typing import Protocol

from app.core.params import Params
from app.core.site import SiteModel
from app.services.access import Principal
from app.services.errors import AppError, ErrorCode, invalid_field
from app.sessions.ports import SiteSource


class Sites(SiteSource, Protocol):
    """What is asked of the sites."""

    def site_ids(self) -> tuple[str, ...]:
        """Return the ids of all sites."""
        ...

    def default_profile(self, site_id: str) -> str:
        """Return the profile of sessions that name none."""
        ...


def choose_site(
    sites: Sites, principal: Principal, asked: str | None, usual: str | None = None
) -> SiteModel:
    """Return the site asked for; else the usual one, the token's, or the only one there is.

    A usual site that is gone, or out of the token's scope, is passed over.

    Raises
    ------
    AppError
        If it is not there, not in the token's scope, or still open.
    """
    site_id = asked
    if site_id is None and usual in sites.site_ids() and principal.covers_site(usual):
        site_id = usual
    if site_id is None:
        site_id = principal.site_id or _only_site(sites)
    if site_id is None:
        detail = "say the site: the server has not exactly one of them"
        raise AppError(ErrorCode.SITE_REQUIRED, detail)
    if not principal.covers_site(site_id):
        raise AppError(ErrorCode.SITE_FORBIDDEN, f"the token is not for site {site_id!r}")
    site = sites.current(site_id)
    if site is None:
        raise invalid_field(pointer="#/site", detail=f"there is no site {site_id!r}")
    return site


def choose_params(sites: Sites, site_id: str, *wanted: str | None) -> Params:
    """Return the parameters of the first profile that is named, else the site's usual ones."""
    named = next((name for name in wanted if name), None)
    profile = named or sites.default_profile(site_id)
    try:
        return sites.params(site_id, profile)
    except KeyError as error:
        detail = f"there is no profile {profile!r}"
        raise invalid_field(pointer="#/profile", detail=detail) from error


def _only_site(sites: Sites) -> str | None:
    site_ids = sites.site_ids()
    return site_ids[0] if len(site_ids) == 1 else None
