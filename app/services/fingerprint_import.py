"""A table of fingerprints becomes a site's next radio map."""

from collections.abc import Callable, Sequence

from sqlalchemy import Connection

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.survey import SurveyPoint
from app.services.errors import AppError, ErrorCode, found
from app.storage import floors, radio_maps, sites
from app.storage.radio_maps import RadioMapOrigin, StoredRadioMap


def storing_fingerprints(
    site_id: str, points: Sequence[SurveyPoint], origin: RadioMapOrigin
) -> Callable[[Connection], StoredRadioMap]:
    """Return the one transaction that stores a table as the site's active radio map.

    The map that was active stays stored. AppError if the site or one of the floors is not there.
    """

    def statement(connection: Connection) -> StoredRadioMap:
        found(sites.get_site(connection, site_id), "site", site_id)
        floor_ids = [floor.floor_id for floor in floors.floors_of_site(connection, site_id)]
        unknown = sorted({point.floor_id for point in points} - set(floor_ids))
        if unknown:
            known = ", ".join(floor_ids) or "none"
            detail = f"site {site_id!r} has no floor {', '.join(unknown)}; it has: {known}"
            raise AppError(ErrorCode.INVALID_FIELD, detail)
        fingerprints = [_fingerprint(floor_ids.index(p.floor_id), p) for p in points]
        radio_map = build_radio_map(floor_ids, fingerprints)
        return radio_maps.save_radio_map(connection, site_id, radio_map, origin, activate=True)

    return statement


def _fingerprint(floor_index: int, point: SurveyPoint) -> Fingerprint:
    return Fingerprint(floor_index, point.x_m, point.y_m, point.wifi_dbm, point.ble_dbm, point.walk)
