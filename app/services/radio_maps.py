"""Radio maps of a site: made active, taken back, removed, compared, and carried as files."""

from sqlalchemy import Connection

from app.core.fingerprint.comparison import Comparison, ComparisonParams, compare_maps
from app.core.fingerprint.radio_map import RadioMap
from app.core.params import MatchParams
from app.formats.radio_map_file import (
    RadioMapFile,
    RadioMapFileError,
    read_radio_map,
    write_radio_map,
)
from app.services.errors import AppError, ErrorCode, found
from app.storage import floors, radio_maps, sites
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap


def activate(connection: Connection, radio_map_id: str) -> StoredRadioMap:
    """Make a radio map the one that its site is matched with."""
    return radio_maps.activate_radio_map(connection, _stored(connection, radio_map_id))


def roll_back(connection: Connection, site_id: str) -> StoredRadioMap:
    """Make the radio map active again that was so before the active one."""
    found(sites.get_site(connection, site_id), "site", site_id)
    earlier = radio_maps.roll_back(connection, site_id)
    if earlier is None:
        detail = f"site {site_id!r} had no radio map before the active one"
        raise AppError(ErrorCode.CONFLICT, detail)
    return earlier


def remove(connection: Connection, radio_map_id: str) -> None:
    """Remove a radio map, which must not be the active one."""
    if _stored(connection, radio_map_id).active:
        detail = f"radio map {radio_map_id!r} is active; activate another one first"
        raise AppError(ErrorCode.IN_USE, detail)
    radio_maps.delete_radio_map(connection, radio_map_id)


def load_pair(connection: Connection, before: str, after: str) -> tuple[RadioMap, RadioMap]:
    """Return two radio maps of one site, to be compared."""
    if _stored(connection, before).site_id != _stored(connection, after).site_id:
        detail = f"radio maps {before!r} and {after!r} are of different sites"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    one, other = (radio_maps.load_radio_map(connection, one) for one in (before, after))
    return found(one, "radio map", before), found(other, "radio map", after)


def compared(before: RadioMap, after: RadioMap) -> Comparison:
    """Return what changed from one map to another; takes seconds for a large one."""
    return compare_maps(before, after, MatchParams(), ComparisonParams())


def exported(connection: Connection, radio_map_id: str) -> bytes:
    """Return a radio map as a file."""
    stored = _stored(connection, radio_map_id)
    radio_map = found(
        radio_maps.load_radio_map(connection, radio_map_id), "radio map", radio_map_id
    )
    statistics = radio_maps.load_statistics(connection, radio_map_id)
    return write_radio_map(RadioMapFile(stored.name, radio_map, statistics, stored.provenance))


def read_file(raw: bytes) -> RadioMapFile:
    """Return what a file holds; AppError says what is wrong with it."""
    try:
        return read_radio_map(raw)
    except RadioMapFileError as error:
        detail = f"the file is not a radio map: {error}"
        raise AppError(ErrorCode.MALFORMED_BODY, detail) from error


def imported(
    connection: Connection, site_id: str, content: RadioMapFile, created_s: float
) -> StoredRadioMap:
    """Store the map of a file as the site's next version, not active.

    AppError if it has fingerprints on a floor that the site does not have.
    """
    found(sites.get_site(connection, site_id), "site", site_id)
    known = [floor.floor_id for floor in floors.floors_of_site(connection, site_id)]
    surveyed = {content.radio_map.floor_ids[i] for i in content.radio_map.floor_index.tolist()}
    if missing := sorted(surveyed - set(known)):
        detail = f"site {site_id!r} has no floor {', '.join(missing)}; it has: {', '.join(known)}"
        raise AppError(ErrorCode.INVALID_FIELD, detail)
    origin = RadioMapOrigin(content.name, created_s, content.provenance, content.statistics)
    return radio_maps.save_radio_map(connection, site_id, content.radio_map, origin, activate=False)


def _stored(connection: Connection, radio_map_id: str) -> StoredRadioMap:
    return found(radio_maps.get_radio_map(connection, radio_map_id), "radio map", radio_map_id)
