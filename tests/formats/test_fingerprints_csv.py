"""The table of fingerprints."""

import pytest

from app.formats.fingerprints_csv import FingerprintTableError, read_fingerprints_csv

HEADER = "point,floor_id,x,y,kind,key,rssi_dbm,walk\n"
TABLE = HEADER + (
    "a,f1,1.5,2,wifi,mac:02-00-5E-00-53-01,-50,w1\n"
    "a,f1,1.5,2,wifi,mac:02:00:5e:00:53:01,-60,w1\n"
    "b,f2,3,4,ble,ibeacon:00112233445566778899AABBCCDDEEFF:1:7,-71.5,\n"
    "a,f1,1.5,2,ble,mac:02005e005302,-80,w1\n"
)


def test_rows_of_a_point_make_one_fingerprint_and_repeated_levels_their_mean() -> None:
    first, second = read_fingerprints_csv(TABLE)
    assert (first.point, first.floor_id, first.x_m, first.y_m, first.walk) == (
        *("a", "f1", 1.5, 2.0),
        "w1",
    )
    assert first.wifi_dbm == {"mac:02005e005301": -55.0}
    assert first.ble_dbm == {"mac:02005e005302": -80.0}
    assert second.wifi_dbm == {}
    assert second.ble_dbm == {"ibeacon:00112233-4455-6677-8899-aabbccddeeff:1:7": -71.5}


def test_walk_may_be_left_out_and_columns_may_come_in_any_order() -> None:
    table = "\ufeffkey,kind,rssi_dbm,y,x,floor_id,point\nmac:02005e005301,wifi,-50,2,1,f1,a\n"
    (point,) = read_fingerprints_csv(table)
    assert (point.x_m, point.y_m, point.walk) == (1.0, 2.0, "")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("", "line 1: the header lacks"),
        (HEADER, "no rows"),
        ("point,colour\n", "has unknown colour"),
        (HEADER + "a,f1,1,2,wifi,mac:02005e005301\n", "line 2: the row has not as many fields"),
        (HEADER + "a,f1,east,2,wifi,mac:02005e005301,-50,\n", "line 2: x 'east' is not a number"),
        (HEADER + "a,f1,nan,2,wifi,mac:02005e005301,-50,\n", "is not a number"),
        (HEADER + "a,f1,1,2,uwb,mac:02005e005301,-50,\n", "neither wifi nor ble"),
        (HEADER + "a,f1,1,2,wifi,02005e005301,-50,\n", "line 2: '02005e005301' is not mac:"),
        (HEADER + "a,f1,1,2,wifi,mac:02005e005301,50,\n", "rssi_dbm 50 is not in -127..-1"),
        (TABLE + "a,f1,9,2,wifi,mac:02005e005301,-50,w1\n", "line 6: point 'a' is at another"),
        (HEADER + '"a,f1\n', "unexpected end of data"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused_with_its_line(table: str, words: str) -> None:
    with pytest.raises(FingerprintTableError, match=words.replace("(", r"\(")):
        read_fingerprints_csv(table)
