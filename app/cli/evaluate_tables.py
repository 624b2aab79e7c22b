"""``pharos evaluate`` for data sets that are a few tables."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, TypeAlias, TypeVar

import typer

from app.cli.errors import CommandError
from app.cli.evaluate_output import JsonOption, give
from app.formats import kolakowski as kolakowski_files
from app.formats import oxford_steps as oxford_files
from app.formats import uji_ble as uji_ble_files
from app.formats import ujiindoorloc as ujiindoorloc_files
from app.services.evaluation import kolakowski, oxford_steps, uji_ble, ujiindoorloc

Folder: TypeAlias = Annotated[
    Path, typer.Argument(metavar="DIR", help="The data set.", exists=True, file_okay=False)
]
Read = TypeVar("Read")


def evaluate_uji_ble(
    folder: Folder,
    zone: Annotated[str, typer.Option(metavar="ZONE", help="Part of the library.")],
    json_file: JsonOption = None,
) -> None:
    """Locate scans at known points among known beacons."""
    anchors, scans = _read(lambda: uji_ble_files.read_zone(folder, zone))
    obstacles = _read(lambda: uji_ble_files.read_obstacles(folder, zone))
    give(uji_ble.evaluate(anchors, obstacles, scans, zone), json_file)


def evaluate_kolakowski(folder: Folder, json_file: JsonOption = None) -> None:
    """Follow a robot through a flat with six known receivers."""
    anchors = _read(lambda: kolakowski_files.read_anchors(folder))
    surveyed, asked = (
        _read(partial(kolakowski_files.read_recording, folder / name, anchors))
        for name in (kolakowski_files.CALIBRATION, kolakowski_files.ROBOT)
    )
    walls = _read(lambda: kolakowski_files.read_walls(folder))
    give(kolakowski.evaluate(anchors, walls, surveyed, asked), json_file)


def evaluate_ujiindoorloc(folder: Folder, json_file: JsonOption = None) -> None:
    """Match single Wi-Fi scans with the fingerprints of three buildings."""
    training = _read(lambda: ujiindoorloc_files.read_scans(folder / ujiindoorloc_files.TRAINING))
    asked = _read(lambda: ujiindoorloc_files.read_scans(folder / ujiindoorloc_files.VALIDATION))
    give(ujiindoorloc.evaluate(training, asked), json_file)


def evaluate_oxford_steps(folder: Folder, json_file: JsonOption = None) -> None:
    """Count steps with the phone carried in six ways, and compare with the true counts."""
    paths = oxford_files.recording_paths(folder)
    if not paths:
        msg = f"there is no step recording in {folder}"
        raise CommandError(msg)
    recordings = _read(lambda: [oxford_files.read_recording(path) for path in paths])
    give(oxford_steps.evaluate(recordings), json_file)


def _read(reading: Callable[[], Read]) -> Read:
    try:
        return reading()
    except (OSError, ValueError) as error:
        raise CommandError(str(error)) from error
