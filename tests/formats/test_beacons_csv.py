"""Beacons as CSV."""

import pytest

from app.formats.beacons_csv import BeaconTableError, read_beacons_csv, write_beacons_csv
from app.formats.transmitters import canonical_key

UUID = "F7826DA6-4FA2-4E98-8024-BC5B71E0893E"


def test_a_table_read_and_written_is_the_same_table() -> None:
    text = (
        "beacon_id,kind,name,floor_id,x,y,z,ref_level_dbm,ref_distance_m,path_loss_exponent,"
        "shadowing_db,keys,last_heard_at,battery_percent,battery_v,temperature_c\n"
        'b1,ble,"Door, east",F1,1.5,2.0,2.7,-60.0,1.0,2.1,5.0,'
        f"mac:a4c138000001 ibeacon:{UUID.lower()}:1:2,,,,\n"
    )
    rows = list(read_beacons_csv(text))
    assert [row.error for row in rows] == [""]
    assert write_beacons_csv(row.fields for row in rows) == text


def test_identity_columns_make_keys() -> None:
    header = "\ufeffbeacon_id,kind,floor_id,x,y,mac,uuid,major,minor\n"
    (row,) = read_beacons_csv(f"{header}b,ble,F,0,0,A4:C1:38:00:00:01,{UUID},1,2\n")
    assert row.fields["keys"] == [f"ibeacon:{UUID.lower()}:1:2", "mac:a4c138000001"]
    assert "z" not in row.fields
    assert {"z", "ref_level_dbm"} < row.unsaid


def test_an_empty_cell_says_something_and_a_column_that_is_not_there_does_not() -> None:
    (row,) = read_beacons_csv("beacon_id,kind,floor_id,x,y,mac,z\nb,ble,F,0,0,A4:C1:38:00:00:01,\n")
    assert "z" not in row.fields | dict.fromkeys(row.unsaid)
    assert "shadowing_db" in row.unsaid


def test_a_bad_row_is_told_by_its_line_and_takes_nobody_with_it() -> None:
    text = (
        "beacon_id,kind,floor_id,x,y,keys\n"
        "b1,ble,F,zero,0,mac:a4c138000001\n"
        "b2,ble,F,0,0,mac:a4\n"
        "b3,ble,F,0\n"
        "b4,ble,F,0,0,mac:a4c138000004\n"
    )
    rows = list(read_beacons_csv(text))
    assert [(row.line, bool(row.error)) for row in rows] == [
        (2, True),
        (3, True),
        (4, True),
        (5, False),
    ]
    assert "x: 'zero'" in rows[0].error


@pytest.mark.parametrize(
    "text",
    [
        "",
        "beacon_id,kind\n",
        "beacon_id,kind,floor_id,x_m,y_m,keys\n",
        "beacon_id,kind,floor_id,x,y\n",
        'beacon_id,kind,floor_id,x,y,keys\n"b1\n',
    ],
)
def test_what_is_no_table_is_refused(text: str) -> None:
    with pytest.raises(BeaconTableError):
        list(read_beacons_csv(text))


@pytest.mark.parametrize(
    ("spelling", "canonical"),
    [
        ("MAC:A4-C1-38-00-00-01", "mac:a4c138000001"),
        (f"iBeacon:{UUID.replace('-', '')}:01:2", f"ibeacon:{UUID.lower()}:1:2"),
        ("eddystone:" + "AB" * 10 + ":0102030405FF", "eddystone:" + "ab" * 10 + ":0102030405ff"),
        ("altbeacon:" + "0F" * 20, "altbeacon:" + "0f" * 20),
    ],
)
def test_every_spelling_of_a_key_is_one_key(spelling: str, canonical: str) -> None:
    assert canonical_key(spelling) == canonical
    assert canonical_key(canonical) == canonical


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a4c138000001",
        "mac:a4c13800000",
        "mac:a4c13800000g",
        f"ibeacon:{UUID}:65536:0",
        f"ibeacon:{UUID}:1",
        f"ibeacon:{UUID}:-1:0",
        "ibeacon:x:1:2",
        "eddystone:ab:cd",
    ],
)
def test_what_is_no_key_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not"):
        canonical_key(text)
