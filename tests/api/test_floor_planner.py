"""Predicted error of a floor's beacons or of drafted ones: figures, forms, access, limits."""

import io
import sys

import httpx
import numpy as np
import pytest
from api_server import BEACONS, ApiServer
from PIL import Image

from app.core.lateration.predicted import Schedule, cell_centres, predicted_sigma_m
from app.core.radio import walls
from app.core.radio.path_loss import level_model
from app.core.types import Anchor

pytestmark = pytest.mark.anyio

PATH = "/v1/floors/lab-0/predicted-accuracy"
CORNERS = [{"x": 0, "y": 0}, {"x": 10, "y": 0}, {"x": 10, "y": 10}, {"x": 0, "y": 10}]
ROOM = {"floor_id": "room", "site_id": "lab", "name": "Room", "ordinal": 3}
PUBLISHED = {"noise_db": 5, "path_loss_exponent": 1.6, "epochs": 28, "period_s": 0.07}


async def planned(client: httpx.AsyncClient, body: dict, path: str = PATH) -> dict:
    reply = await client.post(path, json=body)
    assert reply.status_code == 200, reply.text
    told: dict = reply.json()
    return told


async def refused(client: httpx.AsyncClient, body: dict, pointer: str, path: str = PATH) -> None:
    reply = await client.post(path, json=body)
    assert (reply.status_code, reply.json()["code"]) == (422, "invalid_field"), reply.text
    assert [e["pointer"] for e in reply.json()["errors"]] == [pointer]


def wall(x_m: float, **properties: object) -> dict:
    line = {"type": "LineString", "coordinates": [[x_m, -1], [x_m, 11]]}
    return {"type": "Feature", "properties": {"kind": "wall", **properties}, "geometry": line}


def walkable(width_m: float) -> dict:
    ring = [[0, 0], [width_m, 0], [width_m, 10], [0, 10], [0, 0]]
    area = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "properties": {"kind": "walkable"}, "geometry": area}


async def put_map(client: httpx.AsyncClient, *features: dict) -> None:
    document = {"type": "FeatureCollection", "features": list(features)}
    assert (await client.put("/v1/floors/lab-0/map", json=document)).status_code == 204


async def test_the_registered_beacons_are_judged_as_they_are(server: ApiServer) -> None:
    async with server.client("viewer") as viewer:
        told = await planned(viewer, {"phone_height_m": 1.2, "bound_m": 2.5})
    anchors = [Anchor(f"b{i}", (), "lab-0", x, y, 2.7) for i, (x, y) in BEACONS.items()]
    x_m, y_m = cell_centres(20.0, 10.0, 0.5)
    assert (told["rows"], told["columns"], told["cells"]) == (20, 40, 800)
    assert [b["id"] for b in told["beacons"]] == ["b1", "b2", "b3", "b4", "b5"]
    for name, kinematic in (("static", False), ("kinematic", True)):
        expected_m = predicted_sigma_m(
            level_model(anchors, 1.2), x_m, y_m, Schedule(), kinematic=kinematic
        )
        np.testing.assert_allclose(np.array(told[name]["grid"]), expected_m, atol=6e-4)
        share = float(np.mean(expected_m <= 2.5))
        assert told[name]["share_below"] == pytest.approx(share, abs=1e-3)
        assert told[name]["median"] == pytest.approx(float(np.median(expected_m)), abs=1e-3)
    assert np.array(told["in_range"]["grid"]).tolist() == [[5] * 40] * 20
    assert (told["drop_one"], told["add"], told["cover"]) == (None, None, None)


async def test_a_draft_in_a_square_room_gives_the_published_table(server: ApiServer) -> None:
    async with server.client() as admin:
        made = await admin.post("/v1/floors", json={**ROOM, "width": 10.0, "height": 10.0})
        assert made.status_code == 201, made.text
        path = "/v1/floors/room/predicted-accuracy"
        four = await planned(admin, {**PUBLISHED, "beacons": CORNERS}, path)
        middles = [{"x": 5, "y": 0}, {"x": 10, "y": 5}, {"x": 5, "y": 10}, {"x": 0, "y": 5}]
        eight = await planned(admin, {**PUBLISHED, "beacons": [*CORNERS, *middles]}, path)
    expected = {"static": (0.94, 1.05, 1.29), "kinematic": (1.83, 2.05, 2.52)}
    for name, figures in expected.items():
        found = [four[name][key] for key in ("min", "median", "max")]
        assert found == pytest.approx(figures, abs=0.0051)
    expected = {"static": (0.44, 0.51, 0.64), "kinematic": (0.85, 1.00, 1.24)}
    for name, figures in expected.items():
        found = [eight[name][key] for key in ("min", "median", "max")]
        assert found == pytest.approx(figures, abs=0.0051)


async def test_what_to_leave_out_and_what_to_add(server: ApiServer) -> None:
    async with server.client() as admin:
        body = {"drop_one": True, "add": 2, "cover_m": 1.5, "cell_m": 1.0}
        told = await planned(admin, body)
        walked = await planned(admin, {**body, "model": "kinematic"})
        left = [b for b in told["beacons"] if b["id"] != told["drop_one"][0]["id"]]
        without = await planned(admin, {"beacons": [{**b, "z": 2.7} for b in left], "cell_m": 1.0})
        added = [{"x": b["x"], "y": b["y"], "z": 2.7} for b in told["add"]]
        kept = [{"x": b["x"], "y": b["y"], "z": 2.7} for b in told["cover"]["beacons"]]
        hung = [{"x": b["x"], "y": b["y"], "z": 2.7} for b in told["beacons"]]
        with_two = await planned(admin, {"beacons": [*hung, *added], "cell_m": 1.0})
        covered = await planned(admin, {"beacons": [*hung, *kept], "cell_m": 1.0, "bound_m": 1.5})
    variances = [step["mean_variance_m2"] for step in told["drop_one"]]
    assert variances == sorted(variances, reverse=True)
    assert {step["id"] for step in told["drop_one"]} == {"b1", "b2", "b3", "b4", "b5"}
    for key in ("min", "median", "max", "mean_variance_m2"):
        assert told["drop_one"][0][key] == pytest.approx(without["static"][key], abs=1e-3)
        assert told["add"][1][key] == pytest.approx(with_two["static"][key], abs=2e-3)
    falling = [told["static"]["mean_variance_m2"], *(s["mean_variance_m2"] for s in told["add"])]
    assert falling == sorted(falling, reverse=True)
    assert told["cover"]["reached"]
    assert covered["static"]["share_below"] == 1.0
    assert len(walked["cover"]["beacons"]) > len(told["cover"]["beacons"])


async def test_walls_of_the_map_count_by_their_material(server: ApiServer) -> None:
    async with server.client() as admin:
        await put_map(admin, walkable(16), wall(12.5, material="concrete"))
        body = {"cell_m": 1.0, "hearing_threshold_dbm": -90}
        told = await planned(admin, body)
        paper = await planned(admin, {**body, "materials": {"concrete": 0}})
        none = await planned(admin, {**body, "walls": []})
        drafted = [{"line": [[12.5, -1], [12.5, 11]], "material": "concrete"}]
        own = await planned(admin, {**body, "walls": drafted})
    assert told["cells"] == 160
    grid = told["in_range"]["grid"]
    assert {row[16] for row in grid} == {None}
    assert {row[16] for row in told["static"]["grid"]} == {None}
    assert min(row[0] for row in grid) < 5
    assert [row[:16] for row in paper["in_range"]["grid"]] == [[5] * 16] * 10
    assert none["in_range"] == paper["in_range"]
    assert own["in_range"] == told["in_range"]


async def test_new_beacons_hang_over_walkable_floor_or_beside_it(server: ApiServer) -> None:
    async with server.client() as admin:
        await put_map(admin, walkable(1))
        told = await planned(admin, {"cell_m": 1.0, "add": 6, "beacons": []})
    assert len(told["add"]) == 6
    assert all(beacon["x"] <= 2.5 for beacon in told["add"])


async def test_conditions_of_the_plan_win_over_the_registry_and_a_drafts_own_over_them(
    server: ApiServer,
) -> None:
    async with server.client() as admin:
        as_registered = await planned(admin, {"cell_m": 2.0})
        louder = await planned(admin, {"cell_m": 2.0, "noise_db": 10})
        hung = [{**b, "z": 2.7} for b in as_registered["beacons"]]
        drafted = await planned(admin, {"cell_m": 2.0, "noise_db": 10, "beacons": hung})
        own = [{**b, "noise_db": 5} for b in hung]
        quieter = await planned(admin, {"cell_m": 2.0, "noise_db": 10, "beacons": own})
        flatter = await planned(admin, {"cell_m": 2.0, "path_loss_exponent": 1})
        weaker = await planned(admin, {"cell_m": 2.0, "ref_level_dbm": -90})
    median_m = as_registered["static"]["median"]
    assert louder["static"]["median"] == pytest.approx(2.0 * median_m, rel=1e-3)
    assert drafted["static"] == louder["static"]
    assert quieter["static"] == as_registered["static"]
    assert flatter["static"]["median"] == pytest.approx(2.0 * median_m, rel=1e-3)
    assert weaker["in_range"]["max"] < 5


async def test_a_map_with_an_unknown_material_is_refused(server: ApiServer) -> None:
    async with server.client() as admin:
        document = {"type": "FeatureCollection", "features": [wall(5, material="cheese")]}
        reply = await admin.put("/v1/floors/lab-0/map", json=document)
        assert reply.status_code == 422
        assert reply.json()["errors"][0]["pointer"] == "#/features/0/properties/material"


async def test_nothing_heard_is_null_and_not_zero(server: ApiServer) -> None:
    async with server.client() as admin:
        told = await planned(admin, {"beacons": [], "cell_m": 5.0, "add": 3})
    assert told["static"]["grid"] == [[None] * 4] * 2
    assert told["static"]["median"] is None
    assert told["static"]["share_below"] == 0.0
    assert told["in_range"]["grid"] == [[0] * 4] * 2
    assert len(told["add"]) == 3
    assert told["add"][0]["max"] is None
    assert told["add"][2]["max"] is not None


async def test_as_geojson_the_floor_lies_on_the_globe(server: ApiServer) -> None:
    body, headers = {"cell_m": 5.0, "add": 1}, {"Accept": "application/geo+json"}
    async with server.client() as admin:
        lost = await admin.post(PATH, json=body, headers=headers)
        assert (lost.status_code, lost.json()["code"]) == (409, "no_georeference")
        points = [
            {"x": 0, "y": 0, "lat": 52.0, "lon": 13.0},
            {"x": 0, "y": 100, "lat": 52.001, "lon": 13.0},
        ]
        where = await admin.put("/v1/sites/lab/georeference", json={"control_points": points})
        assert where.status_code == 200, where.text
        reply = await admin.post(PATH, json=body, headers=headers)
    assert reply.headers["Content-Type"] == "application/geo+json"
    assert reply.headers["Vary"] == "Accept"
    features = reply.json()["features"]
    kinds = [f["properties"]["kind"] for f in features]
    assert kinds == ["cell"] * 8 + ["beacon"] * 5 + ["add"]
    ring = features[0]["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1] == [13.0, 52.0]
    assert ring[2][1] == pytest.approx(52.00005, abs=1e-6)
    assert features[0]["properties"]["in_range"] == 5
    assert features[0]["properties"]["static_m"] < features[0]["properties"]["kinematic_m"]


async def test_as_a_picture_if_there_is_what_draws_it(
    server: ApiServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with server.client() as admin:
        drawn = await admin.post(PATH, json={"add": 1}, headers={"Accept": "image/png"})
        assert drawn.headers["Content-Type"] == "image/png"
        with Image.open(io.BytesIO(drawn.content)) as picture:
            assert picture.format == "PNG"
            assert min(picture.size) > 400
        monkeypatch.setitem(sys.modules, "matplotlib", None)
        reply = await admin.post(PATH, json={}, headers={"Accept": "image/png"})
        assert (reply.status_code, reply.json()["code"]) == (406, "not_acceptable")
        assert "pharos[plots]" in reply.json()["detail"]


@pytest.mark.parametrize(
    ("bearer", "path", "status", "code"),
    [
        (None, PATH, 401, "token_missing"),
        ("phone-7", PATH, 403, "role_forbidden"),
        ("annex-viewer", PATH, 403, "site_forbidden"),
        ("viewer", "/v1/floors/none/predicted-accuracy", 404, "not_found"),
    ],
)
async def test_who_may_not_read_the_floor_may_not_plan_it(
    server: ApiServer, bearer: str | None, path: str, status: int, code: str
) -> None:
    async with server.client(bearer) as client:
        reply = await client.post(path, json={})
        assert (reply.status_code, reply.json()["code"]) == (status, code)


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        ({"cell_m": 0}, "#/cell_m"),
        ({"cell_m": 50}, "#/cell_m"),
        ({"epochs": 1}, "#/epochs"),
        ({"noise_db": 0}, "#/noise_db"),
        ({"add": 21}, "#/add"),
        ({"model": "magic"}, "#/model"),
        ({"beacons": [{"x": 0}]}, "#/beacons/0/y"),
        ({"beacons": [{"x": 0, "y": 0, "id": "a"}, {"x": 1, "y": 1, "id": "a"}]}, "#/beacons/1/id"),
        ({"beacons": [{"x": i, "y": 0} for i in range(501)]}, "#/beacons"),
        ({"walls": [{"line": [[0, 0]]}]}, "#/walls/0/line"),
        ({"walls": [{"line": [[0, 0], [1, 1]], "material": "cheese"}]}, "#/walls/0/material"),
        ({"colour": "red"}, "#/colour"),
    ],
)
async def test_what_cannot_be_meant_is_pointed_at(
    server: ApiServer, body: dict, pointer: str
) -> None:
    async with server.client() as admin:
        await refused(admin, body, pointer)


async def test_plans_that_would_take_the_server_down_are_refused(
    server: ApiServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with server.client() as admin:
        large = {**ROOM, "floor_id": "large", "width": 10_000.0, "height": 10_000.0}
        assert (await admin.post("/v1/floors", json=large)).status_code == 201
        path = "/v1/floors/large/predicted-accuracy"
        await refused(admin, {"cell_m": 0.05}, "#/cell_m", path)
        crowd = [{"x": i % 20, "y": i % 7} for i in range(500)]
        await refused(admin, {"beacons": crowd, "cell_m": 0.1}, "#/cell_m")
        zigzag = {"line": [[i % 20, i % 7] for i in range(1000)], "attenuation_db": 0}
        await refused(admin, {"walls": [zigzag] * 25}, "#/walls")
        monkeypatch.setattr(walls, "MAX_CROSSING_TESTS", 100_000)
        await refused(admin, {"walls": [zigzag]}, "#/cell_m")
