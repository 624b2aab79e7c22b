"""Tables as spreadsheets of other countries write them, and cells like formulas."""

import csv
import io

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from app.core.site import Floor
from app.core.survey import SurveyPoint
from app.formats.beacons_csv import read_beacons_csv, write_beacons_csv
from app.formats.fingerprints_csv import FingerprintTableError, read_fingerprints_csv
from app.formats.labelled_levels_csv import read_levels_csv
from app.formats.separated_values import cell_text, decimal_text, separator_of, text_cell
from app.formats.survey_places import SurveyFrame
from app.formats.survey_tables import read_long_csv, read_wide_csv
from app.formats.survey_uploads import SurveyFormat, format_of

BEACONS = "beacon_id,kind,floor_id,x,y,keys\nb1,ble,F,1.5,-2.25,mac:a4c138000001\n"
LEVELS = "point,floor_id,x,y,kind,key,rssi_dbm\nP,F,1.5,2.25,wifi,mac:a4c138000001,-50.5\n"
LABELLED = "x,y,rssi_dbm,beacon_id\n1.5,2.25,-50.5,b1\n"
WIDE = "WAP001,WAP002,FLOOR,X,Y\n-50.5,100,F,1.5,2.25\n"
FRAME = SurveyFrame((Floor("F", "Ground", "", 0, 0.0, 0.0, 20.0, 10.0),))

OTHERWISE = [
    pytest.param(lambda table: table, id="commas"),
    pytest.param(lambda table: table.replace(",", ";"), id="semicolons"),
    pytest.param(lambda table: table.replace(",", ";").replace(".", ","), id="decimal commas"),
    pytest.param(lambda table: table.replace(",", "\t"), id="tabs"),
]


def numbered(table: str) -> list[tuple[int, bytes]]:
    return list(enumerate(table.encode().splitlines(), 1))


@pytest.mark.parametrize("otherwise", OTHERWISE)
def test_a_table_of_beacons_is_read_however_it_is_separated(otherwise) -> None:
    (row,) = read_beacons_csv(otherwise(BEACONS))
    assert (row.error, row.fields["x"], row.fields["y"]) == ("", 1.5, -2.25)
    assert row.fields["keys"] == ["mac:a4c138000001"]


@pytest.mark.parametrize("otherwise", OTHERWISE)
def test_tables_of_levels_are_read_however_they_are_separated(otherwise) -> None:
    (point,) = read_fingerprints_csv(otherwise(LEVELS))
    assert (point.x_m, point.y_m, point.wifi_dbm) == (1.5, 2.25, {"mac:a4c138000001": -50.5})
    (level,) = read_levels_csv(otherwise(LABELLED))
    assert (level.x_m, level.y_m, level.rssi_dbm, level.beacon_id) == (1.5, 2.25, -50.5, "b1")


@pytest.mark.parametrize("otherwise", OTHERWISE)
def test_uploaded_tables_are_read_however_they_are_separated(otherwise) -> None:
    long, wide = otherwise(LEVELS), otherwise(WIDE)
    assert format_of(long.encode()) is SurveyFormat.CSV
    assert format_of(wide.encode()) is SurveyFormat.WIDE_CSV
    assert placed(read_long_csv("t", numbered(long), FRAME)) == (1.5, 2.25, [-50.5])
    assert placed(read_wide_csv("t", numbered(wide), FRAME)) == (1.5, 2.25, [-50.5])


def placed(records) -> tuple[float, float, list[float]]:
    (point,) = records
    assert isinstance(point, SurveyPoint), point
    return point.x_m, point.y_m, list(point.wifi_dbm.values())


def test_names_of_a_table_with_decimal_commas_keep_theirs() -> None:
    table = LEVELS.replace(",", ";").replace("P;", "door, east;")
    (point,) = read_long_csv("t", numbered(table), FRAME)
    assert isinstance(point, SurveyPoint)
    assert point.point == "door, east"


def test_a_decimal_comma_beside_separating_commas_is_refused_with_the_remedy() -> None:
    (row,) = read_beacons_csv(BEACONS.replace("1.5", '"1,5"'))
    assert row.error == "x: '1,5' is not a number: write a decimal point, or separate cells by ;"
    with pytest.raises(FingerprintTableError, match="line 2: '1,5' is not a number: write"):
        read_fingerprints_csv(LEVELS.replace("1.5", '"1,5"'))


def test_a_thousands_separator_makes_no_number() -> None:
    (row,) = read_beacons_csv(BEACONS.replace(",", ";").replace("1.5", "1.234,5"))
    assert row.error == "x: '1.234,5' is not a number"


def test_separators_inside_quoted_names_do_not_count() -> None:
    assert separator_of('"a;b;c;d",x,y\n;;;;;;') == ","
    assert separator_of("point") == ","
    assert decimal_text("-1,5", ";") == "-1.5"


@given(st.text())
@example("'=1")
@example("''@x")
@example("'plain")
def test_a_text_comes_back_from_its_cell_and_is_no_formula_in_it(text: str) -> None:
    cell = text_cell(text)
    assert cell_text(cell) == text
    assert cell[:1] not in {"=", "+", "-", "@"}


@pytest.mark.parametrize("name", ["=HYPERLINK(1)", "+1", "-desk", "@home", "'=1", "'door", "a=b"])
def test_an_exported_name_is_imported_as_it_was(name: str) -> None:
    row = {"beacon_id": "b", "kind": "ble", "name": name, "floor_id": "F", "x": -1.5, "y": 0.0}
    table = write_beacons_csv([{**row, "keys": ["mac:a4c138000001"]}])
    (cells,) = csv.DictReader(io.StringIO(table))
    assert cells["name"][:1] not in {"=", "+", "-", "@"}
    assert cells["x"] == "-1.5", "a negative number is no formula"
    (back,) = read_beacons_csv(table)
    assert back.fields["name"] == name
