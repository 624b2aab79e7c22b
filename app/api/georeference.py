"""``/v1/sites/{id}/georeference``: control points that put a site's metric frame on the globe."""

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

from fastapi import Request, Response
from pydantic import Field

from app.api.auth import check_site
from app.api.conditional import NOT_MODIFIED, Seen, is_held, not_modified
from app.api.resource import Admin, Context, Metres, Reader, StrictModel, registry_router, tagged
from app.core.georeference import fit_georeference
from app.services import site as site_service
from app.services.errors import found, invalid_field
from app.storage import sites
from app.storage.sites import StoredSite

router = registry_router("/v1/sites", "sites")


class ControlPoint(StrictModel):
    """One place known in both frames: metres of the site, degrees of WGS84."""

    x: Metres
    y: Metres
    lat: Annotated[float, Field(ge=-89, le=89)]
    lon: Annotated[float, Field(ge=-180, le=180)]


class GeoreferenceFields(StrictModel):
    """Control points: two fix direction and scale, three or more an affine map."""

    control_points: Annotated[list[ControlPoint], Field(min_length=2, max_length=200)]


class Georeference(GeoreferenceFields):
    """Control points and how far, root mean square, the fit passes beside them."""

    residual_rms_m: float


@router.get("/{site_id}/georeference", response_model=Georeference, responses=NOT_MODIFIED)
async def get_georeference(
    site_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Georeference | Response:
    """Return a site's control points."""
    check_site(principal, site_id)
    stored = found(
        await context.database.read(lambda c: sites.get_site(c, site_id)), "site", site_id
    )
    points = found(stored.georeference, "georeference of site", site_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(points))


@router.put("/{site_id}/georeference")
async def replace_georeference(
    site_id: str,
    body: GeoreferenceFields,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Georeference:
    """Replace a site's control points; no coordinate of the site frame moves."""
    check_site(principal, site_id)
    points = [point.model_dump() for point in body.control_points]
    try:
        view = _view(points)
    except ValueError as error:
        raise invalid_field(pointer="#/control_points", detail=str(error)) from error
    stored = await site_service.edit_site(context.database, site_id, seen, _setter(points))
    await context.directory.refresh()
    return tagged(response, stored.row_version, view)


@router.delete("/{site_id}/georeference", status_code=204)
async def delete_georeference(site_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Take a site off the globe."""
    check_site(principal, site_id)
    await site_service.edit_site(context.database, site_id, seen, _setter(None))
    await context.directory.refresh()


def _setter(points: list[dict[str, Any]] | None) -> Callable[[StoredSite], StoredSite]:
    return lambda site: replace(site, georeference=points)


def _view(points: list[dict[str, float]]) -> Georeference:
    fit = fit_georeference(site_service.control_points(points))
    return Georeference(
        control_points=[ControlPoint(**point) for point in points],
        residual_rms_m=fit.residual_rms_m,
    )
