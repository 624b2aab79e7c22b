"""``/v1/beacons``: transmitters with a surveyed place and their calibration, one by one."""

from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal, Self

from fastapi import Query, Request, Response
from pydantic import AfterValidator, BaseModel, Field, model_validator

from app.api.auth import Principal, check_site
from app.api.conditional import (
    NOT_MODIFIED,
    MergePatch,
    Seen,
    etag_of,
    is_held,
    not_modified,
    patch_schema,
    patched,
)
from app.api.context import ApiContext
from app.api.fix import iso_time
from app.api.paging import Page, Paging, page_of
from app.api.resource import (
    Admin,
    Context,
    Identifier,
    Instant,
    Metres,
    Reader,
    Reference,
    StrictModel,
    Text,
    created,
    listed_site,
    registry_router,
    tagged,
)
from app.formats.transmitters import canonical_key
from app.services import beacons as beacon_service
from app.services.errors import found, invalid_field
from app.storage import beacons
from app.storage.beacon_health import BeaconHealth, health_of
from app.storage.beacons import BeaconFilter, StoredBeacon

router = registry_router("/v1/beacons", "beacons")

RESERVED_IDS = frozenset({"import", "export", "uuids"})


def _not_reserved(beacon_id: str) -> str:
    if beacon_id in RESERVED_IDS:
        msg = "is the name of a route"
        raise ValueError(msg)
    return beacon_id


Kind = Literal["ble", "wifi"]
Key = Annotated[
    str,
    Field(max_length=100, examples=["mac:a4c138000001"]),
    AfterValidator(canonical_key),
]


class BeaconFields(StrictModel):
    """What an admin may change of a beacon.

    Expected level at distance d: `ref_level_dbm` - 10 `path_loss_exponent` log10(d /
    `ref_distance_m`), with standard deviation `shadowing_db`. Without `floor_id`, `x` and `y` it is
    registered but not placed.
    """

    kind: Kind
    keys: Annotated[list[Key], Field(min_length=1, max_length=16)] = Field(
        description="What phones hear it by: mac:… (or bssid:…), ibeacon:uuid:major:minor, "
        "eddystone:namespace:instance, altbeacon:…; the first is the most specific"
    )
    name: Text = ""
    floor_id: Reference | None = None
    x: Metres | None = None
    y: Metres | None = None
    z: Annotated[float, Field(ge=-100, le=100, description="Metres above the floor")] = 0.0
    ref_level_dbm: Annotated[float, Field(ge=-120, le=20)] = -59.0
    ref_distance_m: Annotated[float, Field(gt=0, le=100)] = 1.0
    path_loss_exponent: Annotated[float, Field(ge=0.5, le=10)] = 2.0
    shadowing_db: Annotated[float, Field(gt=0, le=30)] = 5.0

    @model_validator(mode="after")
    def _is_placed_or_not(self) -> Self:
        if len({self.floor_id is None, self.x is None, self.y is None}) > 1:
            msg = "floor_id, x and y belong together"
            raise ValueError(msg)
        if len(set(self.keys)) < len(self.keys):
            msg = "a key is there twice"
            raise ValueError(msg)
        return self


class NewBeacon(BeaconFields):
    """A beacon to add."""

    beacon_id: Annotated[Identifier, AfterValidator(_not_reserved)]
    site_id: Reference


class Battery(BaseModel):
    """What a beacon told last of its battery and temperature; null: it does not tell that."""

    percent: float | None
    voltage_v: float | None
    temperature_c: float | None
    told_at: str


class Beacon(BeaconFields):
    """A beacon, with what traffic says of it."""

    beacon_id: str
    site_id: str
    last_heard_at: str | None = Field(
        None, description="Event time of the newest reading of any of its keys; null: never"
    )
    battery: Battery | None = Field(None, description="null: it has never told")


class BeaconListing(BaseModel):
    """Which beacons to list."""

    site_id: str | None = None
    floor_id: str | None = None
    kind: Kind | None = None
    not_heard_since: Instant | None = Field(
        None, description="Only those last heard before this instant, or never"
    )


@router.get("")
async def list_beacons(
    principal: Reader, context: Context, paging: Paging, asked: Annotated[BeaconListing, Query()]
) -> Page[Beacon]:
    """List beacons by id."""
    since = asked.not_heard_since
    which = BeaconFilter(
        listed_site(principal, asked.site_id),
        asked.floor_id,
        asked.kind,
        None if since is None else since.timestamp(),
    )
    await context.watch.flush_for_reader()
    rows = await context.database.read(
        lambda c: beacons.list_beacons(c, which, after=paging.after, limit=paging.limit)
    )
    health = await context.database.read(lambda c: health_of(c, [b.beacon_id for b in rows]))
    return page_of(
        rows,
        paging.limit,
        lambda beacon: beacon.beacon_id,
        lambda beacon: beacon_view(beacon, health.get(beacon.beacon_id)),
    )


@router.post("", status_code=201)
async def create_beacon(
    body: NewBeacon, principal: Admin, context: Context, response: Response
) -> Beacon:
    """Add a beacon to a site."""
    check_site(principal, body.site_id)
    stored = await beacon_service.create_beacon(
        context.database, stored_beacon(body.site_id, body.beacon_id, body)
    )
    await context.directory.refresh()
    path = f"/v1/beacons/{stored.beacon_id}"
    return created(response, path, stored.row_version, beacon_view(stored))


class BeaconEdit(StrictModel):
    """A merge-patch of one beacon; `etag` is that of the state it was made on."""

    beacon_id: Reference
    etag: Annotated[str, Field(max_length=40)] | None = None
    patch: dict[str, Any]


class BeaconEdits(StrictModel):
    """Several edits, made all or none."""

    items: Annotated[list[BeaconEdit], Field(min_length=1, max_length=2000)]


class TaggedBeacon(Beacon):
    """A beacon with its entity tag, which a list has no header for."""

    etag: str


@router.patch("")
async def patch_beacons(
    body: BeaconEdits, principal: Admin, context: Context
) -> dict[str, list[TaggedBeacon]]:
    """Change several beacons, all or none; an `etag` that is not the stored one refuses all."""
    edits = {}
    for i, item in enumerate(body.items):
        await _beacon(context, principal, item.beacon_id)
        seen = None if item.etag is None else frozenset({item.etag.strip('"')})
        edits[item.beacon_id] = (seen, partial(_edited, item.patch, i))
    if len(edits) < len(body.items):
        raise invalid_field(pointer="#/items", detail="a beacon is there twice")
    stored = await beacon_service.edit_beacons(context.database, edits)
    await context.directory.refresh()
    health = await context.database.read(
        lambda c: health_of(c, [beacon.beacon_id for beacon in stored])
    )
    views = [(beacon_view(b, health.get(b.beacon_id)), etag_of(b.row_version)) for b in stored]
    return {"items": [TaggedBeacon(**view.model_dump(), etag=etag) for view, etag in views]}


@router.get("/{beacon_id}", response_model=Beacon, responses=NOT_MODIFIED)
async def get_beacon(
    beacon_id: str, principal: Reader, context: Context, request: Request, response: Response
) -> Beacon | Response:
    """Return one beacon. Its ETag tells edits; being heard does not change it."""
    stored = await _beacon(context, principal, beacon_id)
    if is_held(request, stored.row_version):
        return not_modified(stored.row_version)
    return tagged(response, stored.row_version, await _seen_view(context, stored))


@router.put("/{beacon_id}")
async def replace_beacon(
    beacon_id: str,
    body: BeaconFields,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Beacon:
    """Replace everything that may be changed of a beacon."""
    await _beacon(context, principal, beacon_id)
    stored = await beacon_service.edit_beacon(
        context.database, beacon_id, seen, lambda beacon: replace(beacon, **_columns(body))
    )
    await context.directory.refresh()
    return tagged(response, stored.row_version, await _seen_view(context, stored))


@router.patch("/{beacon_id}", openapi_extra=patch_schema(BeaconFields))
async def patch_beacon(
    beacon_id: str,
    patch: MergePatch,
    principal: Admin,
    context: Context,
    seen: Seen,
    response: Response,
) -> Beacon:
    """Change some fields of a beacon (merge-patch)."""
    await _beacon(context, principal, beacon_id)
    stored = await beacon_service.edit_beacon(
        context.database, beacon_id, seen, lambda beacon: _patched_beacon(beacon, patch)
    )
    await context.directory.refresh()
    return tagged(response, stored.row_version, await _seen_view(context, stored))


@router.delete("/{beacon_id}", status_code=204)
async def delete_beacon(beacon_id: str, principal: Admin, context: Context, seen: Seen) -> None:
    """Remove a beacon."""
    await _beacon(context, principal, beacon_id)
    await beacon_service.delete_beacon(context.database, beacon_id, seen)
    await context.directory.refresh()


def _patched_beacon(beacon: StoredBeacon, patch: dict[str, Any], *place: str | int) -> StoredBeacon:
    return replace(beacon, **_columns(patched(BeaconFields(**_fields(beacon)), patch, *place)))


def _edited(patch: dict[str, Any], item: int, beacon: StoredBeacon) -> StoredBeacon:
    return _patched_beacon(beacon, patch, "items", item, "patch")


def stored_beacon(site_id: str, beacon_id: str, fields: BeaconFields) -> StoredBeacon:
    """Return a new beacon as storage takes it."""
    return StoredBeacon(beacon_id=beacon_id, site_id=site_id, **_columns(fields))


def beacon_view(beacon: StoredBeacon, health: BeaconHealth | None = None) -> Beacon:
    """Return a beacon as the API shows it; without ``health`` it was never heard."""
    return Beacon(
        **_fields(beacon),
        beacon_id=beacon.beacon_id,
        site_id=beacon.site_id,
        last_heard_at=None if health is None else iso_time(health.last_heard_s),
        battery=None if health is None else _battery(health),
    )


def _battery(health: BeaconHealth) -> Battery | None:
    if health.told_s is None:
        return None
    return Battery(
        percent=health.battery_percent,
        voltage_v=health.battery_v,
        temperature_c=health.temperature_degc,
        told_at=iso_time(health.told_s),
    )


async def _seen_view(context: ApiContext, beacon: StoredBeacon) -> Beacon:
    await context.watch.flush_for_reader()
    health = await context.database.read(lambda c: health_of(c, [beacon.beacon_id]))
    return beacon_view(beacon, health.get(beacon.beacon_id))


async def _beacon(context: ApiContext, principal: Principal, beacon_id: str) -> StoredBeacon:
    stored = found(
        await context.database.read(lambda c: beacons.get_beacon(c, beacon_id)),
        "beacon",
        beacon_id,
    )
    check_site(principal, stored.site_id)
    return stored


RENAMED = {"x": "x_m", "y": "y_m", "z": "z_m"}


def _fields(beacon: StoredBeacon) -> dict[str, Any]:
    fields = {name: getattr(beacon, RENAMED.get(name, name)) for name in BeaconFields.model_fields}
    return {**fields, "keys": list(beacon.keys)}


def _columns(fields: BeaconFields) -> dict[str, Any]:
    columns = {RENAMED.get(name, name): getattr(fields, name) for name in BeaconFields.model_fields}
    return {**columns, "keys": tuple(fields.keys)}
