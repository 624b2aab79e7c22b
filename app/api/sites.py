"""``/v1/sites``: places with one metric frame each."""

from dataclasses import replace
from typing import Annotated, Any

from fastapi import Request, Response
from pydantic import Field

from app.api.auth import check_site
from app.api.conditional import (
    NOT_MODIFIED,
    MergePatch,
    Seen,
    is_held,
    not_modified,
    patch_schema,
    patched,
)
from app.api.fix import iso_time
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Identifier,
    Name,
    ProfileName,
    Reader,
    StrictModel,
    created,
    registry_router,
    tagged,
)
from app.services import site as site_service
from app.services.errors import found
from app.storage import sites
from app.storage.sites import StoredSite

router = registry_router("/v1/sites", "sites")


class SiteFields(StrictModel):
    """What an admin may change of a site."""

    name: Name
    retention_days: Annotated[float, Field(gt=0, le=36_500)] | None = Field(
        None, description="How long scans, steps and tracks are kept; null: the server's limit"
    )
    default_profile: ProfileName = Field(
        "best",
        description="Of sessions that name none and whose device has none; one of `/v1/profiles`."
        " Live sessions follow with their next batch",
    )
    grow_map: bool = Field(
        False,
        description="Keep finished sessions aside, so that you may let the radio map grow by them",
    )


class NewSite(SiteFields):
    """A site to add."""

    site_id: Identifier


class Site(SiteFields):
    """A site. ``model_version`` counts all edits that positioning sees."""

    site_id: str
    created: str
    model_version: int
    georeferenced: bool


@router.get("")
async def list_sites(principal: Reader, context: Context, paging: Paging) -> Page[Site]:
    """List the sites that the token reaches, by id."""
    rows = await context.database.read(
        lambda c: sites.list_sites(
            c, site_id=principal.site_id, after=paging.after, limit=paging.limit
        )
    )
    return page_of(rows, paging.limit, lambda site: site.site_id, _view)


@router.post("", status_code=201)
async def create_site(
    body: NewSite, principal: Admin, context: Context, response: Response
) -> Site:
    """Add a site."""
    check_site(principal, body.site_id)
    fields = body.model_dump()
    stored = await site_service.create_site(
        context.database, StoredSite(created_s=context.clock.now_s(), **fields)
    )
    await context.directory.refresh()
    return created(response, f"/v1/sites/{stored.site_id}", stored.row_version, _view(stored))


@router.get("/{site_id}", response_model=Site, responses=NOT_MODIFIED)
async def get_site(
    site_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Site | Response:
    """Return one site."""
    check_site(principal, site_id)
    stored = found(
        await context.database.read(lambda c: sites.get_site(c, site_id)), "site", site_id
    )
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(stored))


@router.put("/{site_id}")
async def replace_site(
    site_id: str,
    body: SiteFields,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Site:
    """Replace everything that may be changed of a site."""
    check_site(principal, site_id)
    stored = await site_service.edit_site(
        context.database, site_id, seen, lambda site: replace(site, **body.model_dump())
    )
    await context.directory.refresh()
    return tagged(response, stored.row_version, _view(stored))


@router.patch("/{site_id}", openapi_extra=patch_schema(SiteFields))
async def patch_site(
    site_id: str,
    patch: MergePatch,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Site:
    """Change some fields of a site (merge-patch)."""
    check_site(principal, site_id)

    def edit(site: StoredSite) -> StoredSite:
        return replace(site, **patched(SiteFields(**_fields(site)), patch).model_dump())

    stored = await site_service.edit_site(context.database, site_id, seen, edit)
    await context.directory.refresh()
    return tagged(response, stored.row_version, _view(stored))


@router.delete("/{site_id}", status_code=204)
async def delete_site(site_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Remove a site that has no floors any more, with all that was recorded in it."""
    check_site(principal, site_id)
    await site_service.delete_site(context.database, site_id, seen)
    context.authenticator.forget()
    await context.directory.refresh()


def _fields(site: StoredSite) -> dict[str, Any]:
    return {name: getattr(site, name) for name in SiteFields.model_fields}


def _view(site: StoredSite) -> Site:
    return Site(
        **_fields(site),
        site_id=site.site_id,
        created=iso_time(site.created_s),
        model_version=site.model_version,
        georeferenced=site.georeference is not None,
    )
