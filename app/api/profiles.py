"""``/v1/profiles``: the ways to make fixes, with the parameters that each reads."""

from app.api.paging import Page
from app.api.resource import Reader, registry_router
from app.services.profiles import ProfileView, find_profile, list_profiles

router = registry_router("/v1/profiles", "profiles")


@router.get("")
async def list_all_profiles(_principal: Reader) -> Page[ProfileView]:
    """List the profiles that sites, devices and sessions may name."""
    return Page(items=list_profiles(), next_cursor=None)


@router.get("/{name}")
async def get_profile(name: str, _principal: Reader) -> ProfileView:
    """Return one profile: where it comes from, the parameters it reads with units, by block."""
    return find_profile(name)
