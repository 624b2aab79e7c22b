"""``/v1/radio-maps/{id}/report`` and ``/ageing``: how good a radio map is, and how it ages."""

from typing import Annotated

from fastapi import Body, Depends, Request, Response
from pydantic import BaseModel, Field

from app.api.auth import Role, check_site, require
from app.api.fix import iso_time
from app.api.resource import Context, Reader, StrictModel, registry_router
from app.api.survey_report_formats import report_json
from app.api.survey_report_reply import REPORT_REPLIES, report_reply, report_type
from app.services.access import Principal
from app.services.errors import found
from app.services.survey_reports import report_of
from app.storage import ageing, radio_maps
from app.storage.ageing import AgedTransmitter

router = registry_router("/v1/radio-maps", "radio maps")

Surveyor = Annotated[Principal, Depends(require(Role.SURVEYOR))]


class Aged(BaseModel):
    """A transmitter that traffic contradicts, with the evidence (docs/ageing.md)."""

    key: str
    change: str
    excess: float
    scans: int
    misplaced: int
    expected: float
    found: str
    quarantined: bool


class Ageing(BaseModel):
    """What traffic contradicts of a radio map, the worst first."""

    transmitters: list[Aged]


class Quarantine(StrictModel):
    """Which of the listed transmitters are left out of matching from now on, and which not."""

    quarantine: list[str] = Field(default_factory=list, max_length=10_000)
    release: list[str] = Field(default_factory=list, max_length=10_000)


Asked = Annotated[Quarantine, Body(examples=[{"quarantine": ["mac:02005e005301"], "release": []}])]


@router.get("/{radio_map_id}/report", response_class=Response, responses=REPORT_REPLIES)
async def get_report(
    radio_map_id: str, principal: Reader, context: Context, request: Request
) -> Response:
    """Return the survey report in metres, by Accept as JSON or as a page to be printed."""
    media_type = report_type(request)
    await _checked(principal, context, radio_map_id)
    told = await context.database.read(lambda c: report_of(c, radio_map_id))
    document = report_json(told, context.clock.now_s())
    return await report_reply(media_type, document, told.reported)


@router.get("/{radio_map_id}/ageing")
async def get_ageing(radio_map_id: str, principal: Reader, context: Context) -> Ageing:
    """List the transmitters that traffic contradicts, as found last."""
    await _checked(principal, context, radio_map_id)
    return _view(await context.database.read(lambda c: ageing.list_aged(c, radio_map_id)))


@router.post("/{radio_map_id}/ageing")
async def find_ageing(radio_map_id: str, principal: Surveyor, context: Context) -> Ageing:
    """Hold the traffic of the last fortnight against the radio map, now."""
    await _checked(principal, context, radio_map_id)
    return _view(await context.ageing.look(radio_map_id, context.clock.now_s()))


@router.patch("/{radio_map_id}/ageing")
async def quarantine(
    radio_map_id: str, body: Asked, principal: Surveyor, context: Context
) -> Ageing:
    """Leave listed transmitters out of matching, or take them in again."""
    await _checked(principal, context, radio_map_id)
    aged = await context.ageing.quarantine(radio_map_id, body.quarantine, body.release)
    await context.directory.refresh()
    return _view(aged)


async def _checked(principal: Principal, context: Context, radio_map_id: str) -> None:
    stored = found(
        await context.database.read(lambda c: radio_maps.get_radio_map(c, radio_map_id)),
        "radio map",
        radio_map_id,
    )
    check_site(principal, stored.site_id)


def _view(aged: list[AgedTransmitter]) -> Ageing:
    return Ageing(
        transmitters=[
            Aged(
                key=a.suspect.key,
                change=a.suspect.change.value,
                excess=round(a.suspect.excess, 4),
                scans=a.suspect.scans,
                misplaced=a.suspect.misplaced,
                expected=round(a.suspect.expected, 1),
                found=iso_time(a.found_s),
                quarantined=a.quarantined,
            )
            for a in aged
        ]
    )
