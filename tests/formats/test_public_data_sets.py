"""Parsers of the data sets that accuracy is measured on, on tiny made-up files."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from app.formats import kolakowski, oxford_steps, uji_ble, ujiindoorloc


def gzipped(path: Path, text: str) -> Path:
    with gzip.open(path, "wt", encoding="ascii") as file:
        file.write(text)
    return path


def test_a_step_recording_is_cut_into_seconds_with_its_own_rate(tmp_path: Path) -> None:
    rows = [f"{i * 20_000_000},0.1,0.2,9.8,7,{100 + i // 25},0" for i in range(101)]
    gzipped(tmp_path / "anna_bag_17.csv.gz", "\n".join(rows))
    (path,) = oxford_steps.recording_paths(tmp_path)
    recording = oxford_steps.read_recording(path)
    assert (recording.name, recording.carried, recording.true_steps) == ("anna_bag_17", "bag", 4)
    # The lone sample of the third second makes no block.
    assert [block.time_s for block in recording.blocks] == [0.0, 1.0]
    assert [len(block.acc_mps2) for block in recording.blocks] == [50, 50]
    assert recording.blocks[0].rate_hz == pytest.approx(50.0)
    np.testing.assert_allclose(recording.blocks[0].acc_mps2[0], [0.1, 0.2, 9.8], rtol=1e-6)


def test_what_is_no_step_recording_is_refused_by_name(tmp_path: Path) -> None:
    path = gzipped(tmp_path / "anna_bag_17.csv.gz", "hello,world")
    with pytest.raises(ValueError, match=r"anna_bag_17\.csv\.gz"):
        oxford_steps.read_recording(path)


UJI_HEAD = "WAP001,WAP002,LONGITUDE,LATITUDE,FLOOR,BUILDINGID,SPACEID"


def test_a_wifi_fingerprint_names_its_floor_and_leaves_out_what_was_not_heard(
    tmp_path: Path,
) -> None:
    path = gzipped(tmp_path / "t.csv.gz", f"{UJI_HEAD}\n-70,100,-7500.5,4864900,2,1,106\n")
    (scan,) = ujiindoorloc.read_scans(path)
    assert (scan.floor, scan.x_m, scan.y_m) == ("1-2", -7500.5, 4864900.0)
    assert scan.rssi_dbm == {"WAP001": -70.0}


def test_a_table_without_places_is_refused(tmp_path: Path) -> None:
    path = gzipped(tmp_path / "t.csv.gz", "WAP001,FLOOR\n-70,2\n")
    with pytest.raises(ValueError, match=r"t\.csv\.gz"):
        ujiindoorloc.read_scans(path)


def uji_folder(folder: Path) -> Path:
    (folder / "anchors.csv").write_text("anchor_id,zone,x_m,y_m\na,geo,1,2\nb,lib,3,4\n")
    (folder / "samples.csv").write_text(
        "sample_id,zone,raw_id,phone,tx_power_dbm,campaign,point,rep,x_m,y_m\n"
        "s0,geo,1,A5,-4,1,7,1,5.5,6.5\ns1,geo,2,A5,-4,1,7,2,5.5,6.5\ns2,lib,3,A5,-4,1,1,1,0,0\n"
    )
    (folder / "rssi.csv").write_text("sample_id,anchor_id,rssi_dbm,t_ns\ns0,a,-63,2500000000\n")
    return folder


def test_a_zone_has_its_own_anchors_and_scans_even_those_that_heard_nothing(
    tmp_path: Path,
) -> None:
    anchors, scans = uji_ble.read_zone(uji_folder(tmp_path), "geo")
    assert [(a.anchor_id, a.x_m, a.y_m) for a in anchors] == [("a", 1.0, 2.0)]
    assert [scan.levels for scan in scans] == [(uji_ble.LevelAt("a", 2.5, -63.0),), ()]
    assert (scans[0].phone, scans[0].tx_power_dbm, scans[0].point) == ("A5", -4, 7)
    assert (scans[0].x_m, scans[0].y_m) == (5.5, 6.5)


def test_an_unknown_zone_and_a_foreign_table_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no zone 'mars'"):
        uji_ble.read_zone(uji_folder(tmp_path), "mars")
    (tmp_path / "anchors.csv").write_text("id,zone\n1,geo\n")
    with pytest.raises(ValueError, match="not tables"):
        uji_ble.read_zone(tmp_path, "geo")


def test_a_drive_has_a_level_per_receiver_or_none(tmp_path: Path) -> None:
    (tmp_path / "anchors.csv").write_text("anchor_id,x_m,y_m,z_m\n1,0,0,2.1\n2,5,0,2.2\n")
    drive = tmp_path / "drive.csv"
    drive.write_text("t_ms,x_m,y_m,heading_rad,rssi_1,rssi_2\n1500,1,2,0.1,-60.5,\n")
    anchors = kolakowski.read_anchors(tmp_path)
    assert [(a.x_m, a.z_m) for a in anchors] == [(0.0, 2.1), (5.0, 2.2)]
    recording = kolakowski.read_recording(drive, anchors)
    assert (recording.time_s[0], recording.x_m[0], recording.y_m[0]) == (1.5, 1.0, 2.0)
    np.testing.assert_array_equal(recording.rssi_dbm, [[-60.5, np.nan]])
    drive.write_text("t_ms,x_m\n1,2\n")
    with pytest.raises(ValueError, match=r"drive\.csv"):
        kolakowski.read_recording(drive, anchors)
