"""``pharos calibrate beacons``: level models of beacons, fitted on levels at known places."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.api.beacon_tables import checked_rows
from app.api.beacons import beacon_view
from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption
from app.core.types import Anchor
from app.formats.beacons_csv import BeaconTableError, read_beacons_csv, write_beacons_csv
from app.formats.labelled_levels_csv import LevelTableError, read_levels_csv
from app.services.beacon_calibration import FloorCalibration, PositionError
from app.services.beacon_calibration import calibrate_floor as calibrate
from app.services.calibration_sources import LabelledLevel, listed, registered_names
from app.services.errors import AppError
from app.storage.beacons import StoredBeacon

SITE = "table"


def calibrate_beacons(
    beacons: Annotated[
        Path, typer.Argument(metavar="BEACONS.csv", help="One floor's beacons, as exported.")
    ],
    levels: Annotated[
        Path, typer.Argument(metavar="LEVELS.csv", help="x, y, rssi_dbm, beacon_id or key.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the beacons with the new values, to import."),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Fit the level models of a floor's beacons and phones' offsets, as the server does.

    The registry is not touched; import what --out writes.
    """
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
        _write(out, write_beacons_csv(beacon_view(b).model_dump() for b in fitted).encode())
    text = msgspec.json.format(msgspec.json.encode(asdict(found))) + b"\n"
    if json_file == Path("-"):
        typer.echo(text.decode(), nl=False)
        return
    if json_file is not None:
        _write(json_file, text)
    _print(found)


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
    if len({beacon.floor_id for beacon in taken} - {None}) != 1:
        msg = f"{path}: the placed beacons are to be of one floor"
        raise CommandError(msg)
    return taken


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


def _write(path: Path, content: bytes) -> None:
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"{path} cannot be written: {error.strerror}"
        raise CommandError(msg) from error


def _print(found: FloorCalibration) -> None:
    console = Console()
    table = Table(title=f"{len(found.beacons)} beacons")
    table.add_column("beacon", no_wrap=True)
    for heading in ("levels", "dBm at d*", "exponent", "residual dB"):
        table.add_column(heading, justify="right")
    table.add_column("warnings", overflow="fold")
    for beacon in found.beacons:
        residual_db = beacon.after_residual_db
        table.add_row(
            escape(beacon.beacon_id),
            str(beacon.levels),
            f"{beacon.after.ref_level_dbm:.1f}",
            f"{beacon.after.path_loss_exponent:.2f}",
            "" if residual_db is None else f"{residual_db:.1f}",
            " ".join(beacon.warnings),
        )
    console.print(table)
    for phone in found.phones if len(found.phones) > 1 else ():
        console.print(f"{escape(phone.device_id)} hears {phone.offset_db:+.1f} dB")
    console.print(
        f"Mean error at places left out: {_told(found.before)} before, {_told(found.after)} after"
    )


def _told(error: PositionError) -> str:
    return "unknown" if error.mean_error_m is None else f"{error.mean_error_m:.2f} m"
