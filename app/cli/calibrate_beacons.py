"""``pharos calibrate beacons``: level models of beacons, fitted on levels at known places."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from app.api.beacon_tables import checked_rows
from app.api.beacons import beacon_view
from app.cli.calibrate_report import print_draft, print_report
from app.cli.calibrate_source import (
    AskedSource,
    DeviceOption,
    SessionOption,
    SurveyOption,
    TraceOption,
    drafted_levels,
)
from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption
from app.cli.files import write_file
from app.cli.local import DatabaseOption
from app.core.types import Anchor
from app.formats.beacons_csv import BeaconTableError, read_beacons_csv, write_beacons_csv
from app.formats.labelled_levels_csv import LevelTableError, read_levels_csv
from app.services.beacon_calibration import calibrate_floor as calibrate
from app.services.calibration_drafts import LEVELS
from app.services.calibration_sources import LabelledLevel, listed, registered_names
from app.services.errors import AppError
from app.storage.beacons import StoredBeacon

SITE = "table"


def calibrate_beacons(  # noqa: PLR0913 - one parameter per option
    beacons: Annotated[
        Path | None,
        typer.Argument(metavar="BEACONS.csv", help="One floor's beacons, as exported."),
    ] = None,
    levels: Annotated[
        Path | None,
        typer.Argument(metavar="LEVELS.csv", help="x, y, rssi_dbm, beacon_id or key."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the beacons with the new values, to import."),
    ] = None,
    floor: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Instead of tables: a floor of the database."),
    ] = None,
    survey: SurveyOption = None,
    device: DeviceOption = None,
    session: SessionOption = None,
    trace: TraceOption = None,
    json_file: JsonOption = None,
    database: DatabaseOption = None,
) -> None:
    """Fit the level models of a floor's beacons and phones' offsets, as the server does.

    Of two tables, or of a floor of the database and one source: a survey, a session with truth
    records, or recorded traces. The registry is not touched: import what --out writes, or apply the
    draft that --floor makes.
    """
    source = AskedSource(survey, device, session, tuple(trace or ()))
    if floor is not None and beacons is None:
        print_draft(drafted_levels(database, floor, source), json_file)
        return
    if beacons is None or levels is None or floor is not None or source.is_named:
        msg = "either BEACONS.csv and LEVELS.csv, or --floor and a source, are needed"
        raise CommandError(msg, 2)
    _calibrate_tables(beacons, levels, out, json_file)


def _calibrate_tables(
    beacons: Path, levels: Path, out: Path | None, json_file: Path | None
) -> None:
    stored = _beacons(beacons)
    anchors = [anchor for beacon in stored if (anchor := _anchor(beacon)) is not None]
    try:
        epochs = listed(_levels(levels)).epochs("", registered_names(stored))
        found = calibrate(epochs, anchors)
    except AppError as error:
        msg = f"{levels}: {error.detail}"
        raise CommandError(msg) from error
    if out is not None:
        after = {beacon.beacon_id: asdict(beacon.after) for beacon in found.beacons}
        fitted = [replace(beacon, **after.get(beacon.beacon_id, {})) for beacon in stored]
        write_file(out, write_beacons_csv(beacon_view(b).model_dump() for b in fitted).encode())
    print_report(LEVELS, asdict(found), json_file)


def _beacons(path: Path) -> list[StoredBeacon]:
    try:
        rows = list(read_beacons_csv(_text(path)))
    except BeaconTableError as error:
        msg = f"{path}: {error}"
        raise CommandError(msg) from error
    taken, _, refused = checked_rows(SITE, rows)
    if refused:
        msg = f"{path}: line {refused[0].line}: {refused[0].detail}"
        raise CommandError(msg)
    beacons = [row.beacon for row in taken]
    if len({beacon.floor_id for beacon in beacons} - {None}) != 1:
        msg = f"{path}: the placed beacons are to be of one floor"
        raise CommandError(msg)
    return beacons


def _levels(path: Path) -> list[LabelledLevel]:
    try:
        rows = read_levels_csv(_text(path))
    except LevelTableError as error:
        msg = f"{path}: {error}"
        raise CommandError(msg) from error
    return [LabelledLevel(r.x_m, r.y_m, r.rssi_dbm, r.beacon_id, r.key, r.device_id) for r in rows]


def _anchor(beacon: StoredBeacon) -> Anchor | None:
    if beacon.floor_id is None or beacon.x_m is None or beacon.y_m is None:
        return None
    return Anchor(
        beacon.beacon_id,
        beacon.keys,
        beacon.floor_id,
        beacon.x_m,
        beacon.y_m,
        beacon.z_m,
        beacon.ref_level_dbm,
        beacon.ref_distance_m,
        beacon.path_loss_exponent,
        beacon.shadowing_db,
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{path} cannot be read: {error}"
        raise CommandError(msg) from error
