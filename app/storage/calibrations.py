"""Calibrations as stored: what was found of a floor's beacons, a draft until it is applied."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, RowMapping, delete, insert, select

from app.storage.rows import unique, update_row
from app.storage.tables import CALIBRATIONS


@dataclass(frozen=True, slots=True)
class StoredCalibration:
    """One calibration.

    Attributes
    ----------
    kind
        ``levels`` (level models at known places) or ``places`` (places and level models).
    source
        Where the labelled levels came from, as JSON.
    report
        What the API shows of it.
    proposed
        Per beacon id the columns to store (`app.storage.beacons.StoredBeacon`), and as
        ``row_version`` what it was read as, 0 for a beacon that is to be added.
    offsets_db
        Per device id what to add to its level offset.
    applied_s
        When its proposals were stored in the registry; None: it is a draft.
    """

    calibration_id: str
    site_id: str
    floor_id: str
    kind: str
    source: Mapping[str, Any]
    report: Mapping[str, Any]
    proposed: Mapping[str, Mapping[str, Any]]
    offsets_db: Mapping[str, float]
    created_s: float
    applied_s: float | None = None
    row_version: int = 1


def insert_calibration(connection: Connection, calibration: StoredCalibration) -> None:
    """Store a new draft."""
    with unique(f"calibration {calibration.calibration_id!r}"):
        connection.execute(
            insert(CALIBRATIONS).values(
                id=calibration.calibration_id,
                site_id=calibration.site_id,
                floor_id=calibration.floor_id,
                kind=calibration.kind,
                source=dict(calibration.source),
                report=dict(calibration.report),
                proposed=dict(calibration.proposed),
                offsets_db=dict(calibration.offsets_db),
                created_s=calibration.created_s,
            )
        )


def mark_applied(connection: Connection, calibration: StoredCalibration, applied_s: float) -> int:
    """Note that a calibration is in the registry now; return its new row version."""
    return update_row(
        connection,
        CALIBRATIONS,
        calibration.calibration_id,
        calibration.row_version,
        {"applied_s": applied_s},
    )


def get_calibration(connection: Connection, calibration_id: str) -> StoredCalibration | None:
    """Return a calibration, None if there is none of this id."""
    query = select(CALIBRATIONS).where(CALIBRATIONS.c.id == calibration_id)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _calibration(row)


def list_calibrations(
    connection: Connection, *, site_id: str | None, after: str | None, limit: int
) -> list[StoredCalibration]:
    """Return up to ``limit + 1`` calibrations by id, of one site or all."""
    query = select(CALIBRATIONS).order_by(CALIBRATIONS.c.id).limit(limit + 1)
    if site_id is not None:
        query = query.where(CALIBRATIONS.c.site_id == site_id)
    if after is not None:
        query = query.where(CALIBRATIONS.c.id > after)
    return [_calibration(row) for row in connection.execute(query).mappings()]


def delete_calibration(connection: Connection, calibration_id: str) -> None:
    """Remove a calibration; what it has changed stays changed."""
    connection.execute(delete(CALIBRATIONS).where(CALIBRATIONS.c.id == calibration_id))


def _calibration(row: RowMapping) -> StoredCalibration:
    fields = dict(row)
    return StoredCalibration(calibration_id=fields.pop("id"), **fields)
