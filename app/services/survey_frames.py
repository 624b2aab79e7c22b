"""What an upload is of, and the site's frame that its records are read in."""

from dataclasses import dataclass

from sqlalchemy import Connection

from app.core.site import Floor
from app.formats.survey_places import SurveyFrame
from app.services.errors import found, invalid_field
from app.services.site import stored_georeference
from app.storage import floors, sites


@dataclass(frozen=True, slots=True)
class UploadRequest:
    """What an upload is of.

    Attributes
    ----------
    floor_id
        The floor of all of it; None: what its records say.
    total_bytes
        How long the file is; None for one that comes in one go.
    """

    site_id: str
    name: str
    floor_id: str | None = None
    total_bytes: int | None = None


def survey_frame(connection: Connection, request: UploadRequest) -> SurveyFrame:
    """Return the site's frame as records are read in it."""
    site = found(sites.get_site(connection, request.site_id), "site", request.site_id)
    known = tuple(
        Floor(
            floor_id=floor.floor_id,
            name=floor.name,
            building=floor.building,
            ordinal=floor.ordinal,
            x0_m=floor.x0_m,
            y0_m=floor.y0_m,
            width_m=floor.width_m,
            height_m=floor.height_m,
        )
        for floor in floors.floors_of_site(connection, request.site_id)
    )
    if not known:
        pointer, detail = "#/site_id", f"site {request.site_id!r} has no floors yet"
        raise invalid_field(pointer, detail)
    chosen = request.floor_id
    if chosen is not None and chosen not in {floor.floor_id for floor in known}:
        pointer, detail = "#/floor_id", f"site {request.site_id!r} has no floor {chosen!r}"
        raise invalid_field(pointer, detail)
    return SurveyFrame(known, stored_georeference(site), chosen)
