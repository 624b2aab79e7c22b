"""``/v1/radio-maps``: which radio maps a site has and which one is active; read-only for now."""

from typing import Annotated, Any

from fastapi import Query
from pydantic import BaseModel

from app.api.auth import check_site
from app.api.fix import iso_time
from app.api.paging import Page, Paging, page_of
from app.api.resource import Context, Reader, listed_site, registry_router
from app.services.errors import found
from app.storage import radio_maps
from app.storage.radio_maps import StoredRadioMap

router = registry_router("/v1/radio-maps", "radio maps")


class RadioMap(BaseModel):
    """A radio map: how much is in it and where it came from."""

    radio_map_id: str
    site_id: str
    version: int
    name: str
    active: bool
    fingerprints: int
    transmitters: int
    created: str
    provenance: dict[str, Any] | None


@router.get("")
async def list_radio_maps(
    principal: Reader,
    context: Context,
    paging: Paging,
    site_id: str | None = None,
    active: Annotated[bool | None, Query(description="Only the active ones, or the others")] = None,
) -> Page[RadioMap]:
    """List radio maps by id."""
    site = listed_site(principal, site_id)
    rows = await context.database.read(
        lambda c: radio_maps.list_radio_maps(
            c, site_id=site, active=active, after=paging.after, limit=paging.limit
        )
    )
    return page_of(rows, paging.limit, lambda radio_map: radio_map.radio_map_id, _view)


@router.get("/{radio_map_id}")
async def get_radio_map(radio_map_id: str, principal: Reader, context: Context) -> RadioMap:
    """Return what is known of one radio map."""
    stored = found(
        await context.database.read(lambda c: radio_maps.get_radio_map(c, radio_map_id)),
        "radio map",
        radio_map_id,
    )
    check_site(principal, stored.site_id)
    return _view(stored)


def _view(radio_map: StoredRadioMap) -> RadioMap:
    return RadioMap(
        radio_map_id=radio_map.radio_map_id,
        site_id=radio_map.site_id,
        version=radio_map.version,
        name=radio_map.name,
        active=radio_map.active,
        fingerprints=radio_map.fingerprints,
        transmitters=radio_map.transmitters,
        created=iso_time(radio_map.created_s),
        provenance=radio_map.provenance,
    )
