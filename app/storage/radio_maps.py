"""Radio maps as stored: versioned per site, at most one of them active."""

from dataclasses import dataclass, replace
from typing import Any
from uuid import uuid4

from sqlalchemy import Connection, RowMapping, delete, func, insert, select, update

from app.core.fingerprint.cleaning import LevelStatistics
from app.core.fingerprint.radio_map import RadioMap
from app.storage.codec import VariantCodec
from app.storage.rows import unique
from app.storage.sites import touch_model
from app.storage.tables import RADIO_MAPS

_CODEC: VariantCodec[RadioMap] = VariantCodec({"radio_map": RadioMap})
_STATISTICS: VariantCodec[LevelStatistics] = VariantCodec({"level_statistics": LevelStatistics})


@dataclass(frozen=True, slots=True)
class StoredRadioMap:
    """What is known of a radio map without loading it.

    Attributes
    ----------
    version
        Counts the maps of a site from 1.
    provenance
        Where it came from, as JSON: survey ids, cleaning parameters.
    """

    radio_map_id: str
    site_id: str
    version: int
    name: str
    active: bool
    fingerprints: int
    transmitters: int
    created_s: float
    provenance: dict[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class RadioMapOrigin:
    """Name, origin and scatter of levels that a radio map is saved with."""

    name: str
    created_s: float
    provenance: dict[str, Any] | None = None
    statistics: LevelStatistics | None = None


_UNLISTED = frozenset({"payload", "statistics", "activation"})
_LISTED = tuple(column for column in RADIO_MAPS.c if column.name not in _UNLISTED)


def save_radio_map(
    connection: Connection,
    site_id: str,
    radio_map: RadioMap,
    origin: RadioMapOrigin,
    *,
    activate: bool,
) -> StoredRadioMap:
    """Store a radio map as the site's next version, and make it the active one if asked."""
    newest = connection.execute(
        select(func.max(RADIO_MAPS.c.version)).where(RADIO_MAPS.c.site_id == site_id)
    ).scalar()
    stored = StoredRadioMap(
        radio_map_id=f"{site_id}-rm-{uuid4().hex[:12]}",
        site_id=site_id,
        version=(newest or 0) + 1,
        name=origin.name,
        active=False,
        fingerprints=radio_map.rows,
        transmitters=len(radio_map.transmitters),
        created_s=origin.created_s,
        provenance=origin.provenance,
    )
    with unique(f"version {stored.version} of the radio map of {site_id!r}"):
        connection.execute(
            insert(RADIO_MAPS).values(
                id=stored.radio_map_id,
                site_id=site_id,
                version=stored.version,
                active=False,
                label=stored.name,
                provenance=stored.provenance,
                fingerprints=stored.fingerprints,
                transmitters=stored.transmitters,
                created_s=stored.created_s,
                payload=_CODEC.encode([radio_map]),
                statistics=(
                    None if origin.statistics is None else _STATISTICS.encode([origin.statistics])
                ),
            )
        )
    return activate_radio_map(connection, stored) if activate else stored


def activate_radio_map(connection: Connection, radio_map: StoredRadioMap) -> StoredRadioMap:
    """Make a stored radio map the one its site is matched with, instead of the one before."""
    latest = connection.execute(
        select(func.max(RADIO_MAPS.c.activation)).where(RADIO_MAPS.c.site_id == radio_map.site_id)
    ).scalar()
    return _make_active(connection, radio_map, (latest or 0) + 1)


def roll_back(connection: Connection, site_id: str) -> StoredRadioMap | None:
    """Make the map active again that was so before the active one; None if there is none.

    The one taken back counts as never active: doing it again goes further back.
    """
    of_site = RADIO_MAPS.c.site_id == site_id
    query = (
        select(*_LISTED, RADIO_MAPS.c.activation)
        .where(of_site, RADIO_MAPS.c.active.is_(False), RADIO_MAPS.c.activation.is_not(None))
        .order_by(RADIO_MAPS.c.activation.desc())
        .limit(1)
    )
    row = connection.execute(query).mappings().one_or_none()
    if row is None:
        return None
    fields = dict(row)
    activation = fields.pop("activation")
    taken_back = update(RADIO_MAPS).where(of_site, RADIO_MAPS.c.active)
    connection.execute(taken_back.values(activation=None))
    return _make_active(connection, _fields_stored(fields), activation)


def _make_active(
    connection: Connection, radio_map: StoredRadioMap, activation: int
) -> StoredRadioMap:
    of_site = RADIO_MAPS.c.site_id == radio_map.site_id
    connection.execute(update(RADIO_MAPS).where(of_site, RADIO_MAPS.c.active).values(active=False))
    connection.execute(
        update(RADIO_MAPS)
        .where(RADIO_MAPS.c.id == radio_map.radio_map_id)
        .values(active=True, activation=activation)
    )
    touch_model(connection, radio_map.site_id)
    return replace(radio_map, active=True)


def delete_radio_map(connection: Connection, radio_map_id: str) -> None:
    """Remove a radio map that is not active; the active one stays."""
    connection.execute(
        delete(RADIO_MAPS).where(RADIO_MAPS.c.id == radio_map_id, RADIO_MAPS.c.active.is_(False))
    )


def load_active(connection: Connection, site_id: str) -> RadioMap | None:
    """Return the active radio map of a site, None if it has none."""
    query = select(RADIO_MAPS.c.payload).where(RADIO_MAPS.c.site_id == site_id, RADIO_MAPS.c.active)
    payload = connection.execute(query).scalar()
    return None if payload is None else _CODEC.decode(payload)[0]


def load_radio_map(connection: Connection, radio_map_id: str) -> RadioMap | None:
    """Return a radio map by its id, active or not."""
    query = select(RADIO_MAPS.c.payload).where(RADIO_MAPS.c.id == radio_map_id)
    payload = connection.execute(query).scalar()
    return None if payload is None else _CODEC.decode(payload)[0]


def load_statistics(connection: Connection, radio_map_id: str) -> LevelStatistics | None:
    """Return the scatter of a map's levels, None if it has no cleaned reference points."""
    query = select(RADIO_MAPS.c.statistics).where(RADIO_MAPS.c.id == radio_map_id)
    payload = connection.execute(query).scalar()
    return None if payload is None else _STATISTICS.decode(payload)[0]


def get_radio_map(connection: Connection, radio_map_id: str) -> StoredRadioMap | None:
    """Return what is known of a radio map."""
    query = select(*_LISTED).where(RADIO_MAPS.c.id == radio_map_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _stored(row)


def list_radio_maps(
    connection: Connection,
    *,
    site_id: str | None = None,
    active: bool | None = None,
    after: str | None = None,
    limit: int,
) -> list[StoredRadioMap]:
    """Return up to ``limit + 1`` radio maps by id, of one site or all."""
    query = select(*_LISTED).order_by(RADIO_MAPS.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(RADIO_MAPS.c.site_id == site_id)
    if active is not None:
        query = query.where(RADIO_MAPS.c.active == active)
    if after is not None:
        query = query.where(RADIO_MAPS.c.id > after)
    return [_stored(row) for row in connection.execute(query).mappings()]


def _stored(row: RowMapping) -> StoredRadioMap:
    return _fields_stored(dict(row))


def _fields_stored(fields: dict[str, Any]) -> StoredRadioMap:
    return StoredRadioMap(radio_map_id=fields.pop("id"), name=fields.pop("label"), **fields)
