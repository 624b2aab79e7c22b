"""``pharos calibrate`` on the database: drafts of places and levels, shown, applied, discarded."""

import asyncio
import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from app.cli.errors import CommandError
from app.cli.main import cli
from app.core.session import LoggedBatch, SessionClock, SessionRecord
from app.core.types import BleScan, Observation, Reading, Truth
from app.storage.beacons import StoredBeacon, beacons_of_site, insert_beacon
from app.storage.database import Database
from app.storage.enrolment import Sighting, record_sighting
from app.storage.floors import StoredFloor, insert_floor
from app.storage.log import SqlObservationLog
from app.storage.sites import StoredSite, insert_site

UUID = "f7826da6-4fa2-4e98-8024-bc5b71e0893e"
PLACES = {1: (1.0, 1.0), 2: (19.0, 1.0), 3: (19.0, 11.0), 4: (1.0, 11.0), 5: (8.0, 5.0)}
"""Beacon 5 is registered without a place, 6 is not registered."""
UNKNOWN = {6: (13.0, 8.0)}
T0_S = 1_795_314_000
TURNS = [(0.5, y) if (y // 2) % 2 == 0 else (19.5, y) for y in range(0, 13, 2) for _ in (0, 1)]
WALK = [(x if i % 2 == 0 else 20.0 - x, float(y)) for i, (x, y) in enumerate(TURNS)]
"""Corners of a walk there and back through a floor of 20 m by 12 m."""

Calibrate = Callable[..., Result]


def level_dbm(minor: int, x_m: float, y_m: float) -> float:
    bx, by = {**PLACES, **UNKNOWN}[minor]
    return -58.0 - 2.0 * (minor % 3) - 22.0 * math.log10(math.hypot(bx - x_m, by - y_m, 1.2))


def steps() -> list[tuple[float, float, float]]:
    """Time, x and y of each half second of the walk, at 1 m/s."""
    told, time_s = [], float(T0_S)
    for (x0, y0), (x1, y1) in pairwise(WALK):
        count = max(round(2.0 * math.hypot(x1 - x0, y1 - y0)), 1)
        for i in range(count):
            told.append((time_s, x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count))
            time_s += 0.5
    return [*told, (time_s, *WALK[-1])]


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    corners = set(WALK)
    lines = []
    for time_s, x, y in steps():
        ms = round(1000.0 * time_s)
        if (x, y) in corners:
            lines.append(f"{ms}\tTYPE_WAYPOINT\t{x}\t{y}")
        lines += [
            f"{ms}\tTYPE_BEACON\t{UUID}\t1\t{minor}\t-59\t{round(level_dbm(minor, x, y))}\t1.0"
            f"\ta4c13800000{minor}\t{ms}"
            for minor in {**PLACES, **UNKNOWN}
        ]
    path = tmp_path / "walk.txt"
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def database(database_url: str) -> Database:
    store = Database(database_url)

    def fill(connection) -> None:
        insert_site(connection, StoredSite("lab", "Lab", 0.0))
        insert_floor(connection, StoredFloor("lab-0", "lab", "Ground", 0, 20.0, 12.0))
        for minor, (x, y) in PLACES.items():
            place = {"floor_id": "lab-0", "x_m": x, "y_m": y, "z_m": 1.2} if minor < 5 else {}
            keys = (f"ibeacon:{UUID}:1:{minor}",)
            insert_beacon(connection, StoredBeacon(f"b{minor}", "lab", "ble", keys, **place))

    store.write_now(fill)
    yield store
    store.close_now()


@pytest.fixture
def calibrate(database_url: str, database: Database) -> Calibrate:
    def run(command: str, *arguments: str | Path, columns: int = 200) -> Result:
        words = ["calibrate", command, *map(str, arguments), "--database", database_url]
        return CliRunner().invoke(cli, words, env={"COLUMNS": str(columns)})

    return run


def stored(database: Database) -> dict[str, StoredBeacon]:
    return {b.beacon_id: b for b in database.read_now(lambda c: beacons_of_site(c, "lab"))}


def test_places_are_drafted_shown_and_applied(
    calibrate: Calibrate, trace: Path, database: Database
) -> None:
    drafted = calibrate("places", "lab-0", "--trace", trace, "--register-unknown")
    assert drafted.exit_code == 0, drafted.output
    draft_id = drafted.stdout.strip().splitlines()[-1]
    assert stored(database)["b5"].floor_id is None
    shown = calibrate("show", draft_id, "--json", "-")
    told = {each["beacon_id"]: each for each in json.loads(shown.stdout)["beacons"]}
    assert set(told) == {"b5", f"ibeacon-{UUID.replace('-', '')}-1-6"}
    assert "along" in calibrate("show", draft_id).stdout
    assert calibrate("apply", draft_id).stdout == "beacons changed: 2\n"
    by_id = stored(database)
    placed = by_id["b5"]
    assert math.hypot(placed.x_m - 8.0, placed.y_m - 5.0) < 1.0
    assert (placed.x_m, placed.y_m) == (told["b5"]["x_m"], told["b5"]["y_m"])
    assert "applied" in calibrate("list").stdout
    assert len(by_id) == 6


def test_a_discarded_draft_is_gone_and_changes_nothing(
    calibrate: Calibrate, trace: Path, database: Database
) -> None:
    before = stored(database)
    draft_id = calibrate("places", "lab-0", "--trace", trace).stdout.strip().splitlines()[-1]
    assert calibrate("discard", draft_id).exit_code == 0
    assert calibrate("apply", draft_id).exit_code != 0
    assert stored(database) == before


def test_levels_are_calibrated_of_a_trace_and_of_a_session(
    calibrate: Calibrate, trace: Path, database: Database
) -> None:
    asyncio.run(post_session(database))
    for source in (("--trace", trace), ("--device", "phone-7", "--session", "walk-1")):
        drafted = calibrate("beacons", "--floor", "lab-0", *source, "--json", "-")
        assert drafted.exit_code == 0, drafted.output
        report = json.loads(drafted.stdout)
        exponents = [beacon["after"]["path_loss_exponent"] for beacon in report["beacons"]]
        assert exponents == pytest.approx([2.2] * 4, abs=0.2)
        assert report["left_out"] == "places"


def test_of_two_traces_whole_walks_are_left_out(calibrate: Calibrate, trace: Path) -> None:
    other = trace.with_name("other.txt")
    other.write_text(trace.read_text())
    both = ("--trace", trace, "--trace", other)
    drafted = calibrate("beacons", "--floor", "lab-0", *both)
    assert "Mean error at walks left out" in drafted.output


@pytest.mark.parametrize(
    "source",
    [(), ("--survey", "s", "--device", "d"), ("--session", "w"), ("--trace", "none.txt")],
)
def test_one_source_is_needed(calibrate: Calibrate, source: tuple[str, ...]) -> None:
    for command in (("places", "lab-0"), ("beacons", "--floor", "lab-0")):
        assert isinstance(calibrate(*command, *source).exception, CommandError)


async def post_session(database: Database) -> None:
    log = SqlObservationLog(database)
    sighting = Sighting("phone-7", "lab", "other", "", T0_S)
    await database.write(lambda c: record_sighting(c, sighting))
    clock = SessionClock(recorded=True)
    record = SessionRecord("s1", "phone-7", "walk-1", "lab", "best", clock, T0_S)
    await log.open_session(record)
    corners = set(WALK)
    told: list[Observation] = []
    for time_s, x, y in steps():
        if (x, y) in corners:
            told.append(Truth(time_s, x, y, "lab-0"))
        readings = [Reading((f"ibeacon:{UUID}:1:{m}",), level_dbm(m, x, y)) for m in PLACES]
        told.append(BleScan(time_s, tuple(readings)))
    await log.append(LoggedBatch("s1", 0, b"", T0_S, tuple(told)), clock)


def test_tables_fit_a_terminal_of_80_columns_with_ids_whole(
    calibrate: Calibrate, trace: Path
) -> None:
    drafted = calibrate("places", "lab-0", "--trace", trace, "--register-unknown", columns=80)
    *table, draft_id = drafted.stdout.strip().splitlines()
    assert max(map(len, table)) <= 80
    assert any("│ b5 " in line and line.endswith("│") for line in table)
    assert draft_id in calibrate("list", columns=80).stdout
