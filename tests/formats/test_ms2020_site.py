"""A building folder: floors in one frame, maps, and what is wrong with a folder."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.core.georeference import fit_georeference
from app.formats.floor_map import parse_floor_map
from app.formats.ms2020 import read_trace, truth_at
from app.formats.ms2020_site import BuildingFolderError, read_building

# About 10 m and 20 m at 60 degrees north, where a degree of longitude is half one of latitude.
EAST, NORTH = 0.00018, 0.00018


def box(west: float, south: float, east: float, north: float) -> list[list[list[float]]]:
    return [[[west, south], [east, south], [east, north], [west, north], [west, south]]]


def write_floor(
    folder: Path, number: int, south_west: tuple[float, float], rooms: list[Any] | None = None
) -> None:
    """Write a floor of 10 m by 20 m whose outline is its bounding box."""
    lon, lat = south_west
    areas = [box(lon, lat, lon + EAST, lat + NORTH), *(rooms or [])]
    features = [
        {
            "type": "Feature",
            "properties": {"floor_num": number} if i == 0 else {"name": f"shop {i}"},
            "geometry": {"type": "Polygon", "coordinates": area},
        }
        for i, area in enumerate(areas)
    ]
    folder.mkdir(parents=True)
    collection = {"type": "FeatureCollection", "features": features}
    (folder / "geojson_map.json").write_text(json.dumps(collection))
    (folder / "floor_info.json").write_text('{"map_info": {"width": 10.0, "height": 20.0}}')
    (folder / "floor_image.png").write_bytes(b"\x89PNG\r\n\x1a\n" + folder.name.encode())


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """Return a ground floor, an upper one 5 m east of it, and a cellar 10 m south."""
    folder = tmp_path / "house"
    shop = box(8.0, 60.0, 8.0 + EAST / 2, 60.0 + NORTH / 2)
    write_floor(folder / "F1", 1, (8.0, 60.0), [shop])
    write_floor(folder / "F2", 2, (8.0 + EAST / 2, 60.0))
    write_floor(folder / "B1", -1, (8.0, 60.0 - NORTH / 2))
    (folder / "F1" / "walk.txt").write_text("")
    (folder / "notes").mkdir()
    return folder


def test_floors_stand_in_one_frame_from_the_lowest_up(house: Path) -> None:
    floors = read_building(house).floors
    assert [(f.name, f.ordinal) for f in floors] == [("B1", -1), ("F1", 0), ("F2", 1)]
    corners = [(f.x0_m, f.y0_m) for f in floors]
    assert np.allclose(corners, [(0, 0), (0, 10), (5, 10)], atol=1e-6)
    assert [(f.width_m, f.height_m) for f in floors] == [(10.0, 20.0)] * 3
    assert floors[1].plan_png == b"\x89PNG\r\n\x1a\nF1"
    assert [trace.name for trace in floors[1].traces] == ["walk.txt"]


def test_traces_may_lie_in_a_folder_of_their_own(house: Path) -> None:
    inside = house / "F2" / "path_data_files"
    inside.mkdir()
    (inside / "climb.txt").write_text("1000\tTYPE_WIFI\tshop\t02:00:5e:00:53:01\t-50\t2412\t1000\n")
    floor = read_building(house).floors[2]
    assert [path.name for path in floor.traces] == ["climb.txt"]
    assert read_trace(floor.traces[0]).floor_name == floor.name


def test_shops_are_not_walked_on_and_have_walls(house: Path) -> None:
    floor = read_building(house).floors[1]
    parsed = parse_floor_map(floor.map_document)
    walkable = parsed.raster()
    assert walkable is not None
    assert walkable.distance_at(2.5, 15.0) > 1.0  # in the shop, the south-west quarter
    assert walkable.distance_at(7.5, 15.0) == 0.0
    assert walkable.distance_at(2.5, 25.0) == 0.0
    ends = {(round(w.x0_m, 3), round(w.y0_m, 3)) for w in parsed.walls}
    assert (5.0, 20.0) in ends
    assert (10.0, 30.0) in ends


def test_the_frame_is_tied_to_the_globe(house: Path) -> None:
    globe = fit_georeference(read_building(house).control_points)
    lat_deg, lon_deg = globe.to_wgs84(5.0, 10.0)
    assert lat_deg == pytest.approx(60.0, abs=1e-7)
    assert lon_deg == pytest.approx(8.0 + EAST / 2, abs=1e-7)


def test_a_self_crossing_outline_is_mended(house: Path) -> None:
    path = house / "F1" / "geojson_map.json"
    document = json.loads(path.read_text())
    bow_tie = [[8.0, 60.0], [8.0001, 60.0001], [8.0001, 60.0], [8.0, 60.0001], [8.0, 60.0]]
    document["features"][1]["geometry"]["coordinates"] = [bow_tie]
    path.write_text(json.dumps(document))
    assert parse_floor_map(read_building(house).floors[1].map_document).raster() is not None


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("floor_info.json", "{", "floor_info.json"),
        ("floor_info.json", "[]", "not a JSON object"),
        ("floor_info.json", '{"map_info": {"width": 0, "height": 5}}', "no extent"),
        ("geojson_map.json", '{"features": []}', "size or outline"),
        ("geojson_map.json", '{"features": [{"geometry": null}]}', "size or outline"),
        ("geojson_map.json", None, "geojson_map.json"),
        ("floor_image.png", None, "floor_image.png"),
        ("floor_image.png", "<html>", "not a PNG"),
    ],
)
def test_a_broken_floor_is_named(house: Path, file: str, content: str | None, words: str) -> None:
    path = house / "F2" / file
    path.unlink()
    if content is not None:
        path.write_text(content)
    with pytest.raises(BuildingFolderError, match=words) as refused:
        read_building(house)
    assert "F2" in str(refused.value)


def test_a_folder_without_floors_is_no_building(tmp_path: Path) -> None:
    with pytest.raises(BuildingFolderError, match="no floor in it"):
        read_building(tmp_path)


@pytest.mark.shared_data
def test_surveyed_walks_lie_on_walkable_ground(shared_data: Path) -> None:
    """Frame and map agree with the walks: a wrong sign or offset would put them into shops."""
    building = read_building(shared_data / "ms2020" / "site1")
    assert [f.name for f in building.floors] == ["B1", "F1", "F2"]
    for floor in building.floors:
        walkable = parse_floor_map(floor.map_document).raster()
        assert walkable is not None
        distances_m = []
        for path in floor.traces[:6]:
            waypoints = read_trace(path).waypoints
            for time_s in np.arange(waypoints[0, 0], waypoints[-1, 0]):
                place = truth_at(waypoints, time_s)
                assert place is not None
                distances_m.append(
                    walkable.distance_at(place[0] + floor.x0_m, place[1] + floor.y0_m)
                )
        assert np.mean(np.array(distances_m) == 0.0) > 0.95


def test_a_floor_in_place_of_its_building_is_told_as_one(house: Path) -> None:
    with pytest.raises(BuildingFolderError, match="is a floor: name the folder that it is in"):
        read_building(next(path for path in house.iterdir() if path.is_dir()))
