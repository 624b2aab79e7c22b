import gzip
import io
import lzma
import zipfile
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from survey_files import (
    FRAME,
    LONG_CSV,
    MACS,
    T0_MS,
    WIDE_CSV,
    anyplace,
    geosubmit,
    getsensordata,
    ms2020_trace,
    points_json,
)

from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.formats import upload_streams
from app.formats.survey_places import Reason, SurveyFrame, Unusable, UploadError
from app.formats.survey_uploads import SurveyFormat, UnknownFormat, format_of, read_survey
from app.formats.upload_streams import members

ON_HALL_0 = replace(FRAME, chosen_floor_id="hall-0")


def read(
    body: bytes | str, frame: SurveyFrame = FRAME, name: str = "file"
) -> tuple[list[Surveyed], list[Unusable]]:
    """Return what an upload holds, and what of it cannot be used."""
    raw = body.encode() if isinstance(body, str) else body
    records: list[Surveyed | Unusable] = []
    for member in members(name, io.BytesIO(raw), len(raw)):
        if isinstance(member, Unusable):
            records.append(member)
            continue
        found = format_of(member.stream.peek(4096))
        if isinstance(found, UnknownFormat):
            records.append(Unusable(member.name, Reason.UNKNOWN_FORMAT, found.reason))
        else:
            records += read_survey(found, member.name, member.stream, frame)
    good = [r for r in records if not isinstance(r, Unusable)]
    return good, [r for r in records if isinstance(r, Unusable)]


def zipped(**files: bytes | str) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in files.items():
            out.writestr(name, content)
    return archive.getvalue()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (ms2020_trace(seconds=1), SurveyFormat.MS2020),
        (LONG_CSV, SurveyFormat.CSV),
        (WIDE_CSV, SurveyFormat.WIDE_CSV),
        (points_json(), SurveyFormat.JSON),
        (getsensordata(), SurveyFormat.GETSENSORDATA),
        (geosubmit(), SurveyFormat.GEOSUBMIT),
        (anyplace(), SurveyFormat.ANYPLACE),
    ],
)
def test_the_format_is_found_by_the_content(body: str, expected: SurveyFormat):
    assert format_of(body.encode()) is expected
    assert format_of(b"\xef\xbb\xbf" + body.encode()) is expected


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"", "empty"),
        (LONG_CSV.encode("utf-16"), "UTF-16"),
        (b"\x7fELF\0\0", "binary"),
        (b"Dear sir, ...", "no known format"),
        (b"a,b,c\n1,2,3\n", "no known format"),
    ],
)
def test_what_is_no_survey_is_said_to_be_none(head: bytes, words: str):
    found = format_of(head)
    assert isinstance(found, UnknownFormat)
    assert words in found.reason


def test_a_trace_is_a_walk_with_scans_strides_and_waypoints_in_the_sites_frame():
    (walk,), unusable = read(ms2020_trace("F2"), name="folder/5dd9.txt")
    assert isinstance(walk, SurveyWalk)
    assert unusable == []
    assert (walk.walk, walk.floor_id) == ("5dd9", "hall-1")
    # The plan of F2 begins at x = 100 m.
    assert walk.waypoints.tolist() == [
        [T0_MS / 1000.0, 101.0, 5.0],
        [T0_MS / 1000.0 + 10.0, 106.0, 5.0],
        [T0_MS / 1000.0 + 20.0, 111.0, 5.0],
    ]
    assert len(walk.scans) == 11
    # Two swings a second, each a step; the phone's y axis points north.
    assert 30 <= len(walk.strides) <= 41
    assert np.allclose(walk.strides[2:, 2], np.pi / 2, atol=1e-6)


def test_traces_after_each_other_are_walks_of_their_own():
    both = ms2020_trace() + ms2020_trace("F2", start_ms=T0_MS + 100_000)
    walks, unusable = read(both)
    assert [(w.walk, w.floor_id) for w in walks] == [("file", "hall-0"), ("file-2", "hall-1")]
    assert unusable == []


def test_lines_that_cannot_be_used_are_named_and_the_walk_stays():
    lines = ms2020_trace().splitlines()
    lines[5] = f"{T0_MS}\tTYPE_WIFI\tnet\t{MACS[0]}\tloud\t2412\t{T0_MS}"
    lines[6] = "9" * 400 + "\tTYPE_WAYPOINT\t1\t2"
    (walk,), unusable = read("\n".join(lines))
    assert isinstance(walk, SurveyWalk)
    assert [(u.place, u.reason) for u in unusable] == [
        ("file:line 6", Reason.UNREADABLE),
        ("file:line 7", Reason.UNREADABLE),
    ]


@pytest.mark.parametrize(
    ("trace", "reason"),
    [
        (ms2020_trace("F9"), Reason.UNKNOWN_FLOOR),
        (ms2020_trace().replace("\t5.0\n", "\t500.0\n"), Reason.OUTSIDE_PLAN),
        (ms2020_trace().replace("\t5.0\n", "\tinf\n"), Reason.NOT_A_NUMBER),
        (ms2020_trace().replace("TYPE_WAYPOINT", "TYPE_W"), Reason.NO_WAYPOINT),
        (ms2020_trace().replace("TYPE_WIFI", "TYPE_W"), Reason.NO_SCAN),
    ],
)
def test_a_trace_that_makes_no_map_is_left_out_with_its_reason(trace: str, reason: Reason):
    walks, unusable = read(trace)
    assert walks == []
    assert [u.reason for u in unusable] == [reason]


def test_rows_of_our_csv_that_stand_together_are_one_fingerprint():
    points, unusable = read(LONG_CSV)
    assert unusable == []
    first, second = points
    assert isinstance(first, SurveyPoint)
    assert first.wifi_dbm == {"mac:aabbccddee01": -51.0}
    assert first.ble_dbm == {"mac:aabbccddee02": -70.0}
    assert (first.floor_id, first.x_m, first.y_m, first.walk) == ("hall-0", 1.0, 2.0, "w")
    assert second.point == "P2"


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("P3,attic,1,2,wifi,mac:aabbccddee01,-50,w", Reason.UNKNOWN_FLOOR),
        ("P3,hall-0,1,nan,wifi,mac:aabbccddee01,-50,w", Reason.NOT_A_NUMBER),
        ("P3,hall-0,1,2,wifi,mac:aabbccddee01,12,w", Reason.LEVEL_OUT_OF_RANGE),
        ("P3,hall-0,1,2,smoke,mac:aabbccddee01,-50,w", Reason.BAD_KIND),
        ("P3,hall-0,1,2,wifi,aabb,-50,w", Reason.UNREADABLE),
        ("=HYPERLINK(A1),hall-0,1,2,wifi,mac:aabbccddee01,-50,w", Reason.FORMULA),
        ("P3,hall-0,1,2,wifi", Reason.UNREADABLE),
        ('"P3,hall-0,1,2,wifi,mac:aabbccddee01,-50,w', Reason.UNREADABLE),
    ],
)
def test_a_row_that_cannot_be_meant_is_named_and_the_others_stay(row: str, reason: Reason):
    points, unusable = read(LONG_CSV + row + "\n")
    assert len(points) == 2
    assert [(u.place, u.reason) for u in unusable] == [("file:line 6", reason)]


def test_latin_1_is_refused_row_by_row():
    points, unusable = read(LONG_CSV.encode() + "Küche,hall-0,1,2,wifi,x,-5,w\n".encode("latin-1"))
    assert len(points) == 2
    assert [u.reason for u in unusable] == [Reason.NOT_UTF8]


def test_a_wide_table_has_a_point_per_row_without_what_was_not_heard():
    points, unusable = read(WIDE_CSV + "100,100,100,3,2,0,A,7,1\n")
    assert [p.wifi_dbm for p in points if isinstance(p, SurveyPoint)] == [
        {"name:wap001": -50.0, "name:wap003": -70.0},
        {"name:wap002": -60.0},
    ]
    assert points[0].floor_id == "hall-0"
    assert [(u.place, u.reason) for u in unusable] == [("file:line 4", Reason.NOTHING_HEARD)]


def test_a_wide_table_in_web_mercator_lands_on_the_plan():
    # EPSG:3857 of latitude 50, longitude 10, from the projection's definition.
    table = "WAP001,LONGITUDE,LATITUDE,FLOOR\n-50,1113194.90793,6446275.84102,0\n"
    (point,), _ = read(table)
    assert isinstance(point, SurveyPoint)
    assert (point.x_m, point.y_m) == pytest.approx((0.0, 0.0), abs=0.01)


def test_our_json_is_read_item_by_item():
    points, unusable = read(points_json(x="far"))
    assert [p.point for p in points if isinstance(p, SurveyPoint)] == ["P1"]
    assert [(u.place, u.reason) for u in unusable] == [("file:/points/1", Reason.NOT_A_NUMBER)]


def test_json_is_read_whatever_pieces_it_comes_in(monkeypatch: pytest.MonkeyPatch):
    whole, _ = read(points_json(point="Küche"))
    monkeypatch.setattr("app.formats.survey_json._CHUNK_BYTES", 3)
    assert read(points_json(point="Küche"))[0] == whole


@pytest.mark.parametrize(
    "body",
    [
        points_json()[:-30],
        points_json().replace("1.0", "NaN"),
        '{"points": [' + "[" * 100_000,
        '{"points": ["' + "x" * 3_000_000 + '"]}',
    ],
)
def test_json_that_is_cut_off_or_hostile_is_refused_whole(body: str):
    with pytest.raises(UploadError):
        read(body)


def test_geosubmit_items_lie_where_their_coordinates_say_on_the_floor_of_the_upload():
    (point,), unusable = read(geosubmit(), ON_HALL_0)
    assert isinstance(point, SurveyPoint)
    assert (point.x_m, point.y_m) == pytest.approx((4.0, 3.0), abs=0.01)
    assert point.time_s == T0_MS / 1000.0
    assert len(point.wifi_dbm) == 3
    assert [u.reason for u in unusable] == [Reason.NOTHING_HEARD]
    assert {u.reason for u in read(geosubmit())[1]} == {Reason.UNKNOWN_FLOOR}


def test_a_sensor_log_is_a_walk_between_its_places():
    (walk,), unusable = read(getsensordata(), name="log.txt")
    assert isinstance(walk, SurveyWalk)
    assert walk.waypoints == pytest.approx(np.array([[0, 1, 5], [10, 6, 5]]), abs=0.01)
    assert {r.keys for s in walk.scans for r in s.readings} == {
        ("mac:aabbccddee01",),
        ("ibeacon:00000000-0000-0000-0000-000000000000:1:2", "mac:aabbccddee02"),
    }
    assert [u.reason for u in unusable] == [Reason.NO_WAYPOINT]


def test_anyplace_rows_of_one_time_and_place_are_one_scan():
    points, unusable = read(anyplace())
    places = [(p.x_m, p.y_m) for p in points if isinstance(p, SurveyPoint)]
    assert places == [pytest.approx((2.0, 3.0), abs=0.01), pytest.approx((6.0, 3.0), abs=0.01)]
    assert [u.place for u in unusable] == ["file:line 8"]


def test_without_a_georeference_places_on_the_globe_cannot_be_used():
    points, unusable = read(anyplace(), replace(FRAME, georeference=None))
    assert points == []
    assert Reason.NO_GEOREFERENCE in {u.reason for u in unusable}


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_compressed_files_are_the_same_survey(pack):
    plain, _ = read(LONG_CSV)
    assert read(pack(LONG_CSV.encode()))[0] == plain
    # Streams after each other, with padding, are one file.
    head, tail = LONG_CSV.encode()[:60], LONG_CSV.encode()[60:]
    assert read(pack(head) + b"\0" * 8 + pack(tail) + b"\0" * 4)[0] == plain
    with pytest.raises(UploadError, match="cut off"):
        read(pack(LONG_CSV.encode())[:-9])


def test_a_zip_holds_files_packed_or_not_and_strangers_among_them():
    body = zipped(
        **{
            "F1/a.txt.xz": lzma.compress(ms2020_trace().encode()),
            "F1/b.txt": ms2020_trace(),
            "readme.md": "hello",
        }
    )
    walks, unusable = read(body)
    assert [w.walk for w in walks] == ["a", "b"]
    assert [(u.place, u.reason) for u in unusable] == [("readme.md", Reason.UNKNOWN_FORMAT)]
    with pytest.raises(UploadError, match="broken or cut off"):
        read(body[:-40])


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "a\\..\\..\\b", "c:\\x"])
def test_an_archive_that_reaches_outside_is_refused(name: str):
    with pytest.raises(UploadError, match="outside"):
        read(zipped(**{"good.csv": LONG_CSV, name: LONG_CSV}))


def test_bombs_are_stopped_on_the_way(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(upload_streams, "RATIO_COUNTS_FROM_BYTES", 1 << 16)
    rows = LONG_CSV.encode() + b"P2,hall-0,3,2,wifi,mac:aabbccddee01,-60,w\n" * 40_000
    for bomb in (gzip.compress(rows, 9), lzma.compress(rows), zipped(a=gzip.compress(rows, 9))):
        with pytest.raises(UploadError, match="grows more than"):
            read(bomb)


def test_a_line_without_end_is_refused():
    with pytest.raises(UploadError, match="line 2 is longer"):
        read(LONG_CSV.splitlines()[0] + "\n" + "x" * (1 << 21))


@given(st.binary(max_size=400), st.sampled_from(["csv", "ms", "gsd", "any", "json", "zip", "gz"]))
def test_whatever_bytes_come_are_used_refused_or_named(noise: bytes, kind: str):
    heads = {
        "csv": LONG_CSV.encode(),
        "ms": ms2020_trace(seconds=1).encode(),
        "gsd": b"WIFI;0.1;0.1;a;aa:bb:cc:dd:ee:01;2412;-50\n",
        "any": anyplace().encode(),
        "json": points_json().encode()[:40],
        "zip": zipped(a=LONG_CSV)[:60],
        "gz": gzip.compress(LONG_CSV.encode())[:40],
    }
    with suppress(UploadError):
        read(heads[kind] + noise)
