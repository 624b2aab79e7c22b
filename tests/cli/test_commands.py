"""The command line as it is typed: what it does, and one clear line when it cannot."""

import json
import re
import socket
from pathlib import Path

import pytest
from command_line import Pharos, Result
from server_process import ServerProcess

from app.core.engine import PROFILES
from app.services.tokens import hash_token
from app.storage.beacons import beacons_of_site
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import load_active
from app.storage.sites import StoredSite, get_site, insert_site
from app.storage.tokens import StoredToken, find_token


@pytest.fixture
def stored(database_url: str) -> Database:
    """Return the database that the commands work on, with a site of one floor."""
    database = Database(database_url)
    database.write_now(lambda c: insert_site(c, StoredSite("hall", "Hall", 0.0)))
    floor = StoredFloor("hall-f1", "hall", "F1", 0, 20.0, 10.0)
    database.write_now(lambda c: insert_floor(c, floor))
    yield database
    database.close_now()


def token_of(database: Database, result: Result) -> StoredToken:
    assert result.code == 0, result.err
    token = database.read_now(lambda c: find_token(c, hash_token(result.out.strip())))
    assert token is not None
    return token


def fails(result: Result, code: int, words: str) -> None:
    """One line on stderr, no traceback, the exit code."""
    assert result.code == code, result.err
    lines = result.err.strip().splitlines()
    assert len(lines) == 1, result.err
    assert lines[0].startswith("pharos: ")
    assert words in lines[0]


def test_a_token_is_printed_once_and_stored_as_its_hash(pharos: Pharos, stored: Database) -> None:
    result = pharos(
        *("token", "create", "--role", "device", "--prefix", "cart-", "--site", "hall"),
        *("--name", "carts", "--expires", "2d"),
    )
    token = token_of(stored, result)
    assert (token.role, token.site_id, token.device_prefix) == ("device", "hall", "cart-")
    assert token.expires_s == pytest.approx(token.created_s + 2 * 86400.0)
    listed = pharos("token", "list")
    assert "carts" in listed.out
    assert "cart-*" in listed.out
    assert result.out.strip() not in listed.out


def test_a_revoked_token_is_no_token(pharos: Pharos, stored: Database) -> None:
    created = pharos("token", "create", "--role", "viewer")
    token = token_of(stored, created)
    assert pharos("token", "revoke", token.token_id).code == 0
    assert stored.read_now(lambda c: find_token(c, token.token_hash)) is None
    assert "revoked" in pharos("token", "list").out


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--role", "device"), 2, "needs --device or --prefix"),
        (("--role", "viewer", "--device", "d"), 2, "are for the role device"),
        (("--role", "viewer", "--expires", "soon"), 2, "--expires 'soon'"),
        (("--role", "viewer", "--site", "moon"), 1, "there is no site 'moon'"),
    ],
)
def test_a_token_that_cannot_be_meant_is_refused(
    pharos: Pharos, options: tuple[str, ...], code: int, words: str
) -> None:
    fails(pharos("token", "create", *options), code, words)


def test_revoking_what_is_not_there_fails(pharos: Pharos) -> None:
    fails(pharos("token", "revoke", "tok-none"), 1, "there is no token 'tok-none'")


def test_migrate_brings_up_an_empty_database_and_is_safe_to_repeat(
    pharos: Pharos, tmp_path: Path
) -> None:
    url = f"sqlite:///{tmp_path / 'new.db'}"
    assert "went from nothing" in pharos("migrate", "--database", url).out
    assert "Nothing to do" in pharos("migrate", "--database", url).out


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sqlite:////nowhere/at/all.db", "unable to open database file"),
        ("oracle://x/y", "neither a sqlite nor a postgresql URL"),
        ("postgresql://u:secret@127.0.0.1:1/db", "127.0.0.1:1/db cannot be used"),
        ("rubbish", "cannot be used"),
    ],
)
def test_a_database_that_cannot_be_used_is_one_line_without_its_password(
    pharos: Pharos, url: str, words: str
) -> None:
    for command in (["migrate"], ["token", "list"]):
        result = pharos(*command, "--database", url)
        fails(result, 1, words)
        assert "secret" not in result.err


def test_serve_says_when_its_port_is_in_use(pharos: Pharos) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        fails(pharos("serve", "--port", str(port)), 1, f"127.0.0.1:{port} is in use")


@pytest.mark.parametrize(
    ("name", "value"), [("port", "many"), ("log_level", "loud"), ("cors_origins", "example.org")]
)
def test_settings_that_cannot_be_meant_are_named(
    pharos: Pharos, monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(f"PHAROS_{name.upper()}", value)
    fails(pharos("serve"), 2, name)


def test_the_demo_refuses_a_port_that_is_none(pharos: Pharos) -> None:
    result = pharos("demo", "--port", "99999")
    assert result.code == 2
    assert "--port" in result.err


BEACONS = """beacon_id,kind,floor_id,x,y,mac,ref_level_dbm
b1,ble,hall-f1,1,2,02:00:5e:00:53:01,-60.5
b2,ble,hall-f1,3,4,02:00:5e:00:53:02,
b3,ble,hall-f9,3,4,02:00:5e:00:53:03,
"""


def test_good_rows_of_a_beacon_table_are_taken_and_bad_ones_named(
    pharos: Pharos, stored: Database, tmp_path: Path
) -> None:
    table = tmp_path / "beacons.csv"
    table.write_text(BEACONS)
    result = pharos("import", "csv", "beacons", table, "--site", "hall")
    assert result.code == 1
    assert "line 4 is refused: the site has no floor 'hall-f9'" in result.err
    assert "2 added" in result.err
    found = stored.read_now(lambda c: beacons_of_site(c, "hall"))
    assert [(b.beacon_id, b.ref_level_dbm) for b in found] == [("b1", -60.5), ("b2", -59.0)]


def test_a_dry_run_tells_what_an_import_would_change_and_stores_nothing(
    pharos: Pharos, stored: Database, tmp_path: Path
) -> None:
    table = tmp_path / "beacons.csv"
    table.write_text(BEACONS.replace(",", ";").replace("-60.5", "-60,5"))
    result = pharos("import", "csv", "beacons", table, "--site", "hall", "--dry-run")
    assert "b1 is new" in result.err
    assert "2 would be added" in result.err
    assert stored.read_now(lambda c: beacons_of_site(c, "hall")) == []
    pharos("import", "csv", "beacons", table, "--site", "hall")
    table.write_text(BEACONS.replace("-60.5", "-61"))
    changed = pharos("import", "csv", "beacons", table, "--site", "hall", "--dry-run")
    assert "b1: ref_level_dbm -60.5 to -61.0" in changed.err
    assert stored.read_now(lambda c: beacons_of_site(c, "hall"))[0].ref_level_dbm == -60.5


FINGERPRINTS = """point,floor_id,x,y,kind,key,rssi_dbm
p1,hall-f1,1,2,wifi,mac:02005e005301,-50
p1,hall-f1,1,2,wifi,mac:02005e005302,-60
p2,hall-f1,5,2,wifi,mac:02005e005301,-70
"""


def test_a_table_of_fingerprints_becomes_the_active_radio_map(
    pharos: Pharos, stored: Database, tmp_path: Path
) -> None:
    table = tmp_path / "points.csv"
    table.write_text(FINGERPRINTS)
    assert pharos("import", "csv", "fingerprints", table, "--site", "hall").code == 0
    radio_map = stored.read_now(lambda c: load_active(c, "hall"))
    assert radio_map is not None
    assert radio_map.x_m.tolist() == [1.0, 5.0]
    assert radio_map.transmitters == ("mac:02005e005301", "mac:02005e005302")


@pytest.mark.parametrize(
    ("table", "site", "words"),
    [
        (FINGERPRINTS, "moon", "there is no site 'moon'"),
        (FINGERPRINTS.replace("hall-f1", "hall-f9"), "hall", "has no floor hall-f9"),
        (FINGERPRINTS.replace("-70", "loud"), "hall", "points.csv: line 4"),
    ],
)
def test_a_table_of_fingerprints_is_taken_whole_or_not_at_all(
    pharos: Pharos, stored: Database, tmp_path: Path, table: str, site: str, words: str
) -> None:
    path = tmp_path / "points.csv"
    path.write_text(table)
    fails(pharos("import", "csv", "fingerprints", path, "--site", site), 1, words)
    assert stored.read_now(lambda c: load_active(c, "hall")) is None


def test_replay_says_when_there_is_no_server_or_no_trace(pharos: Pharos, tmp_path: Path) -> None:
    options = ("--server", "http://127.0.0.1:1", "--token", "t")
    fails(pharos("replay", tmp_path, *options), 2, "there is no trace to replay")
    fails(pharos("replay", tmp_path / "x.txt", *options), 2, "there is no trace or folder")
    trace = tmp_path / "x.txt"
    trace.write_text("1000\tTYPE_WAYPOINT\t1\t2\n")
    fails(pharos("replay", trace, *options), 1, "http://127.0.0.1:1 is not reachable")
    fails(pharos("replay", trace, *options, "--speed", "0"), 2, "--speed '0'")


def test_replay_stops_at_a_wrong_token_and_at_an_unreadable_trace(
    pharos: Pharos, live_server: ServerProcess, tmp_path: Path
) -> None:
    trace = tmp_path / "x.txt"
    trace.write_text("1000\tTYPE_WAYPOINT\t1\t2\n")
    server = ("--server", live_server.url)
    fails(pharos("replay", trace, *server, "--token", "no"), 1, "401 token_invalid")
    right = (*server, "--token", live_server.token)
    fails(pharos("replay", trace, *right), 2, "name the site with --site; the server has: none")
    with live_server.client() as client:
        body = {"site_id": "hall", "name": "Hall"}
        client.post("/v1/sites", json=body).raise_for_status()
    fails(pharos("replay", trace, *right), 1, "no scan and no inertial sample in it")


def test_help_names_every_command(pharos: Pharos) -> None:
    shown = pharos("--help").out
    for command in ("serve", "demo", "migrate", "replay", "token", "import"):
        assert command in shown


def test_import_says_what_is_wrong_with_a_folder(pharos: Pharos, tmp_path: Path) -> None:
    fails(pharos("import", "ms2020", tmp_path / "none"), 1, "is not a folder")
    fails(pharos("import", "ms2020", tmp_path), 1, "has no floor in it")
    (tmp_path / "F1").mkdir()
    (tmp_path / "F1" / "floor_info.json").write_text(json.dumps({"map_info": {"width": 1}}))
    fails(pharos("import", "ms2020", tmp_path), 1, "geojson_map.json")


def test_an_import_without_a_usable_walk_changes_nothing(
    pharos: Pharos, building: Path, database_url: str
) -> None:
    trace = building / "F1" / "a.txt"
    trace.write_text("1000\tTYPE_WAYPOINT\t1\t2\n")
    result = pharos("import", "ms2020", building, "--site", "Corner Shop")
    assert result.code == 1
    assert "F1/a.txt is passed over" in result.err
    assert "no walk in it can be used" in result.err
    database = Database(database_url)
    assert database.read_now(lambda c: get_site(c, "corner-shop")) is None
    database.close_now()


def test_a_second_import_needs_replace_and_then_adds_a_radio_map(
    pharos: Pharos, building: Path, database_url: str
) -> None:
    (building / "F1" / "a.txt").write_text(WALK)
    command = ("import", "ms2020", building, "--site", "Corner Shop")
    first = pharos(*command)
    assert first.code == 0, first.err
    assert first.out.strip() == "corner-shop"
    fails(pharos(*command), 1, "there is a site 'corner-shop' already")
    assert pharos(*command, "--replace").code == 0
    database = Database(database_url)
    radio_map = database.read_now(lambda c: load_active(c, "corner-shop"))
    database.close_now()
    assert radio_map is not None
    assert radio_map.floor_ids == ("corner-shop-F1",)
    assert radio_map.x_m.tolist() == [pytest.approx(2.0)]


WALK = "".join(
    [
        "1000000\tTYPE_WAYPOINT\t1\t2\n",
        *(
            f"1001000\tTYPE_WIFI\tnet\t02:00:5e:00:53:0{i}\t-5{i}\t2412\t1000900\n"
            for i in range(4)
        ),
        "1002000\tTYPE_WAYPOINT\t3\t2\n",
    ]
)


@pytest.fixture
def building(tmp_path: Path) -> Path:
    """Return a building of one floor, 20 m by 10 m, without a walk."""
    floor = tmp_path / "shop" / "F1"
    floor.mkdir(parents=True)
    (floor / "floor_info.json").write_text('{"map_info": {"width": 20, "height": 10}}')
    ring = [[8.0, 50.0], [8.001, 50.0], [8.001, 50.001], [8.0, 50.001], [8.0, 50.0]]
    outline = {
        "type": "Feature",
        "properties": {"floor_num": 1},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    (floor / "geojson_map.json").write_text(
        json.dumps({"type": "FeatureCollection", "features": [outline]})
    )
    (floor / "floor_image.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    return floor.parent


def test_profiles_are_shown_with_all_their_parameters(pharos: Pharos) -> None:
    listed = pharos("profiles")
    assert listed.code == 0, listed.err
    assert all(name in listed.out for name in PROFILES)
    shown = pharos("profiles", "best")
    assert re.search(r"match\.max_age_s\W+2\.5\W+s\W+Wi-Fi readings", shown.out)
    one = json.loads(pharos("profiles", "best", "--json").out)
    every = json.loads(pharos("profiles", "--json").out)
    assert [profile["name"] for profile in every] == sorted(PROFILES)
    assert one in every
    fails(pharos("profiles", "bset"), 2, "there is no profile 'bset'; there are: best")
