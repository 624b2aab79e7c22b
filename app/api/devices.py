"""``/v1/devices``: the phones, who carries them, and where each one is now."""

from dataclasses import replace
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from pydantic import Field

from app.api.auth import READERS, Principal, Role, check_device, require
from app.api.conditional import (
    NOT_MODIFIED,
    MergePatch,
    Seen,
    is_held,
    not_modified,
    patch_schema,
    patched,
)
from app.api.context import ApiContext
from app.api.explanation import EXPLAINED_FIX_REPLY, explanation_json
from app.api.fix import iso_time, output_json
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    ProfileName,
    Reader,
    StrictModel,
    Text,
    listed_site,
    registry_router,
    tagged,
)
from app.services import devices as device_service
from app.services.devices import DeviceStatus, status_of
from app.services.errors import AppError, ErrorCode, found
from app.storage import devices
from app.storage.devices import StoredDevice

router = registry_router("/v1/devices", "devices")

Explain = Annotated[bool, Query(description="Add why: 1 adds `explanation`")]
OwnReader = Annotated[Principal, Depends(require(*READERS, Role.DEVICE))]


class DeviceFields(StrictModel):
    """What an admin may say of a device."""

    name: Text = ""
    person: Text | None = None
    level_offset_db: Annotated[float, Field(ge=-40, le=40)] = Field(
        0.0,
        description="How much louder than others it hears; taken off every level that it reports"
        " from its next batch on",
    )
    profile: ProfileName | None = Field(
        None,
        description="Of its sessions that name none, one of `/v1/profiles`; null: the site's."
        " Live sessions follow with their next batch",
    )


class Device(DeviceFields):
    """A phone; `status` is live up to 15 s after its newest batch, stale up to 5 min."""

    device_id: str
    site_id: str | None
    platform: str | None
    model: str | None
    first_seen: str | None
    last_seen: str | None
    status: Annotated[DeviceStatus, Field(strict=False)]


@router.get("")
async def list_devices(
    principal: Reader, context: Context, paging: Paging, site_id: str | None = None
) -> Page[Device]:
    """List devices by id; with a site, those that were there last."""
    site = listed_site(principal, site_id)
    rows = await context.database.read(
        lambda c: devices.list_devices(c, site_id=site, after=paging.after, limit=paging.limit)
    )
    now_s = context.clock.now_s()
    return page_of(rows, paging.limit, lambda d: d.device_id, lambda d: _view(d, now_s))


@router.get("/{device_id}", response_model=Device, responses=NOT_MODIFIED)
async def get_device(
    device_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Device | Response:
    """Return one device. Its ETag tells edits; being seen does not change it."""
    stored = await device_in_scope(context, principal, device_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, _view(stored, context.clock.now_s()))


@router.patch("/{device_id}", openapi_extra=patch_schema(DeviceFields))
async def patch_device(
    device_id: str,
    patch: MergePatch,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Device:
    """Change name, person, level offset or profile (merge-patch)."""
    await device_in_scope(context, principal, device_id)

    def edit(device: StoredDevice) -> StoredDevice:
        return replace(device, **patched(DeviceFields(**_fields(device)), patch).model_dump())

    stored = await device_service.edit_device(context.database, device_id, seen, edit)
    context.ingest.forget(device_id)
    return tagged(response, stored.row_version, _view(stored, context.clock.now_s()))


@router.delete("/{device_id}", status_code=204)
async def erase_device(device_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Erase a device: its observations, tracks and own tokens, for good."""
    await device_in_scope(context, principal, device_id)
    await device_service.erase_device(context.database, context.registry, device_id, seen)
    context.ingest.forget(device_id)
    context.authenticator.forget()


@router.get("/{device_id}/fix", responses={200: EXPLAINED_FIX_REPLY})
async def get_fix(
    device_id: str, principal: OwnReader, context: Context, explain: Explain = False
) -> dict[str, Any]:
    """Return where the device is as of its newest batch, or why that is not known.

    Explained: by which scan, candidates, residuals of transmitters, gate, floors and motion mode.
    """
    device = await device_in_scope(context, principal, device_id)
    explained = await context.registry.explain(device_id) if explain else None
    latest = context.registry.latest(device_id)
    if explained is not None:
        # One state's words, even if another batch has come in between.
        latest = explained[0], explained[1].output
    reasons = {}
    if explain:
        reasons["explanation"] = None if explained is None else explanation_json(explained[1])
    if latest is None:
        return output_json(device_id, device.site_id or "", None) | reasons
    site_id, output = latest
    found(context.directory.current(site_id), "fix of device", device_id)
    if not principal.covers_site(site_id):
        raise AppError(ErrorCode.SITE_FORBIDDEN, f"the token is not for site {site_id!r}")
    georeference = context.directory.georeference(site_id)
    return output_json(device_id, site_id, output, georeference) | reasons


async def device_in_scope(
    context: ApiContext, principal: Principal, device_id: str
) -> StoredDevice:
    """Return a device that the token reaches; one seen last at another site is out of reach."""
    check_device(principal, device_id)
    stored = found(
        await context.database.read(lambda c: devices.get_device(c, device_id)),
        "device",
        device_id,
    )
    if principal.site_id is not None and stored.site_id != principal.site_id:
        detail = f"device {device_id!r} is not at site {principal.site_id!r}"
        raise AppError(ErrorCode.SITE_FORBIDDEN, detail)
    return stored


def _fields(device: StoredDevice) -> dict[str, Any]:
    return {name: getattr(device, name) for name in DeviceFields.model_fields}


def _view(device: StoredDevice, now_s: float) -> Device:
    first_s, last_s = device.first_seen_s, device.last_seen_s
    return Device(
        **_fields(device),
        device_id=device.device_id,
        site_id=device.site_id,
        platform=device.platform,
        model=device.model,
        first_seen=None if first_s is None else iso_time(first_s),
        last_seen=None if last_s is None else iso_time(last_s),
        status=status_of(last_s, now_s),
    )
