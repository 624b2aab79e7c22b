"""Sites, floors, plans, maps, beacons and devices: made, read, edited, removed."""

import io

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record
from PIL import Image

pytestmark = pytest.mark.anyio

FLOOR = {"site_id": "lab", "name": "One", "ordinal": 1, "width": 20.0, "height": 10.0}
MERGE = {"Content-Type": "application/merge-patch+json"}


def feature(kind: str, geometry: dict, **properties: object) -> dict:
    return {"type": "Feature", "properties": {"kind": kind, **properties}, "geometry": geometry}


def polygon(*corners: tuple[float, float]) -> dict:
    return {"type": "Polygon", "coordinates": [[list(corner) for corner in (*corners, corners[0])]]}


def collection(*features: dict) -> dict:
    return {"type": "FeatureCollection", "features": list(features)}


def png(width: int = 4, height: int = 2) -> bytes:
    out = io.BytesIO()
    Image.new("1", (width, height), "white").save(out, "PNG")
    return out.getvalue()


@pytest.mark.parametrize(
    ("path", "body", "change"),
    [
        ("/v1/sites", {"site_id": "new", "name": "New"}, {"name": "Newer"}),
        ("/v1/floors", {**FLOOR, "floor_id": "new"}, {"ordinal": 2}),
        (
            "/v1/beacons",
            {"site_id": "lab", "beacon_id": "new", "kind": "ble", "keys": ["mac:a4c138000001"]},
            {"ref_level_dbm": -63.5},
        ),
    ],
)
async def test_a_resource_is_made_read_edited_and_removed(
    server: ApiServer, path: str, body: dict, change: dict
) -> None:
    async with server.client() as admin:
        made = await admin.post(path, json=body)
        assert made.status_code == 201, made.text
        where = made.headers["Location"]
        assert where == f"{path}/new"
        assert (await admin.post(path, json=body)).json()["code"] == "conflict"

        read = await admin.get(where)
        assert read.json() == made.json()
        assert body.items() <= read.json().items()
        etag = read.headers["ETag"]
        assert etag == made.headers["ETag"]
        held = await admin.get(where, headers={"If-None-Match": etag})
        assert (held.status_code, held.content) == (304, b"")

        stale = {"If-Match": '"99"'}
        weak = {"If-Match": f"W/{etag}"}
        for headers in (stale, weak):
            reply = await admin.patch(where, json=change, headers={**MERGE, **headers})
            assert (reply.status_code, reply.json()["code"]) == (412, "etag_mismatch")
        edited = await admin.patch(where, json=change, headers={**MERGE, "If-Match": etag})
        assert edited.status_code == 200, edited.text
        assert change.items() <= edited.json().items()
        assert edited.headers["ETag"] != etag
        assert (await admin.get(where, headers={"If-None-Match": etag})).status_code == 200

        fields = {k: v for k, v in body.items() if k not in {"site_id", "floor_id", "beacon_id"}}
        if path == "/v1/sites":
            fields = {"name": "New"}
        replaced = await admin.put(where, json=fields, headers=stale)
        assert replaced.status_code == 412
        assert (await admin.put(where, json=fields)).status_code == 200
        assert (await admin.delete(where, headers=stale)).status_code == 412
        assert (await admin.delete(where)).status_code == 204
        for method in ("GET", "PUT", "DELETE"):
            gone = await admin.request(method, where, json=fields if method == "PUT" else None)
            assert (gone.status_code, gone.json()["code"]) == (404, "not_found")


async def test_fields_are_strict(server: ApiServer) -> None:
    beacon = {"site_id": "lab", "kind": "ble", "keys": ["mac:a4c138000001"]}
    wrong = [
        ("/v1/floors", {**FLOOR, "x_m": 1.0}, "#/x_m"),
        ("/v1/floors", {**FLOOR, "width": "20"}, "#/width"),
        ("/v1/floors", {**FLOOR, "width": 0}, "#/width"),
        ("/v1/floors", {**FLOOR, "ordinal": 1.5}, "#/ordinal"),
        ("/v1/floors", {**FLOOR, "floor_id": "a/b"}, "#/floor_id"),
        ("/v1/beacons", {**beacon, "keys": ["a4c138000001"]}, "#/keys/0"),
        ("/v1/beacons", {**beacon, "keys": []}, "#/keys"),
        ("/v1/beacons", {**beacon, "x": 1.0}, "#"),
        ("/v1/beacons", {**beacon, "path_loss_exponent": 0}, "#/path_loss_exponent"),
        ("/v1/beacons", {**beacon, "beacon_id": "import"}, "#/beacon_id"),
        ("/v1/beacons", {**beacon, "floor_id": "none", "x": 0, "y": 0}, "#/floor_id"),
        ("/v1/sites", {"name": ""}, "#/name"),
        ("/v1/sites", {"name": "x", "default_profile": "none"}, "#/default_profile"),
    ]
    async with server.client() as admin:
        for path, body, pointer in wrong:
            reply = await admin.post(path, json=body)
            assert reply.status_code == 422, (path, body)
            assert reply.headers["Content-Type"] == "application/problem+json"
            assert [e["pointer"] for e in reply.json()["errors"]] == [pointer]
        patch = await admin.patch("/v1/beacons/b1", json={"z": "high"}, headers=MERGE)
        assert (patch.status_code, patch.json()["errors"][0]["pointer"]) == (422, "#/z")
        text = await admin.patch(
            "/v1/beacons/b1", content=b"z=1", headers={"Content-Type": "text/plain"}
        )
        assert text.status_code == 415
        broken = await admin.patch("/v1/beacons/b1", content=b"{", headers=MERGE)
        assert (broken.status_code, broken.json()["code"]) == (400, "malformed_body")


async def test_a_patch_takes_null_as_the_default(server: ApiServer) -> None:
    async with server.client() as admin:
        unplaced = {"floor_id": None, "x": None, "y": None}
        reply = await admin.patch("/v1/beacons/b1", json=unplaced, headers=MERGE)
        assert reply.json()["floor_id"] is None
        half = await admin.patch("/v1/beacons/b2", json={"x": None}, headers=MERGE)
    assert half.status_code == 422


async def test_one_key_belongs_to_one_beacon_of_a_site(server: ApiServer) -> None:
    async with server.client() as admin:
        keys = (await admin.get("/v1/beacons/b1")).json()["keys"]
        body = {"kind": "ble", "keys": [keys[0].upper().replace("IBEACON", "ibeacon")]}
        same = await admin.post("/v1/beacons", json={**body, "site_id": "lab"})
        other = await admin.post("/v1/beacons", json={**body, "site_id": "annex"})
    assert (same.status_code, same.json()["code"]) == (409, "conflict")
    assert other.status_code == 201
    assert other.json()["keys"] == keys


async def test_lists_come_in_pages(server: ApiServer) -> None:
    seen = []
    async with server.client() as admin:
        cursor = None
        for _ in range(3):
            params = {"limit": 2, "site_id": "lab"} | ({"cursor": cursor} if cursor else {})
            page = (await admin.get("/v1/beacons", params=params)).json()
            seen += [beacon["beacon_id"] for beacon in page["items"]]
            cursor = page["next_cursor"]
        assert seen == ["b1", "b2", "b3", "b4", "b5"]
        assert cursor is None
        for bad in ("%%%", "abc", "gICA"):
            reply = await admin.get("/v1/beacons", params={"cursor": bad})
            assert (reply.status_code, reply.json()["code"]) == (400, "invalid_cursor"), bad
        for limit in (0, 501, "many"):
            assert (await admin.get("/v1/beacons", params={"limit": limit})).status_code == 422


async def test_nothing_in_use_is_removed(server: ApiServer) -> None:
    async with server.client() as admin:
        for path in ("/v1/sites/lab", "/v1/floors/lab-0"):
            reply = await admin.delete(path)
            assert (reply.status_code, reply.json()["code"]) == (409, "in_use")


async def test_an_edit_reaches_positioning_at_once(server: ApiServer) -> None:
    now_ms = NOW_S * 1000
    async with server.client() as admin, server.client("phone-7") as phone:
        first = (await phone.post("/v1/ingest", json=batch(ble_record(6, 4, now_ms)))).json()
        assert first["fix"]["x"] == pytest.approx(6.0, abs=1.5)
        for minor in range(1, 6):
            place = (await admin.get(f"/v1/beacons/b{minor}")).json()
            moved = {"x": place["x"] + 100.0}
            await admin.patch(f"/v1/beacons/b{minor}", json=moved, headers=MERGE)
        located = {"records": [ble_record(6, 4, now_ms)], "site": "lab"}
        reply = await phone.post("/v1/locate", json={"device": {"id": "phone-7"}, **located})
    assert reply.json()["fix"]["x"] == pytest.approx(106.0, abs=1.0)


async def test_a_plan_is_replaced_without_moving_anything(server: ApiServer) -> None:
    path = "/v1/floors/lab-0/plan"
    async with server.client() as admin:
        before = (await admin.get("/v1/floors/lab-0")).json()
        assert before["plan"] is None
        assert (await admin.get(path)).status_code == 404
        put = await admin.put(path, content=png(), headers={"Content-Type": "image/png"})
        assert put.status_code == 204
        got = await admin.get(path)
        assert (got.content, got.headers["Content-Type"]) == (png(), "image/png")
        assert got.headers["ETag"] == put.headers["ETag"]
        held = await admin.get(path, headers={"If-None-Match": got.headers["ETag"]})
        assert held.status_code == 304
        svg = b'<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg"/>'
        stale = {"Content-Type": "image/svg+xml", "If-Match": '"x"'}
        assert (await admin.put(path, content=svg, headers=stale)).status_code == 412
        fresh = {**stale, "If-Match": got.headers["ETag"]}
        assert (await admin.put(path, content=svg, headers=fresh)).status_code == 204
        shown = await admin.get(path)
        assert "sandbox" in shown.headers["Content-Security-Policy"]
        after = (await admin.get("/v1/floors/lab-0")).json()
        assert after == {**before, "plan": path}
        assert (await admin.delete(path)).status_code == 204
        assert (await admin.get("/v1/floors/lab-0")).json() == before


async def test_a_plan_must_be_a_picture_of_bounded_size(server: ApiServer) -> None:
    cases = [
        (png(), "image/gif", 415),
        (png(), "image/jpeg", 400),
        (b"<html><svg></svg></html>", "image/svg+xml", 400),
        (b"", "image/png", 400),
        (png(9000, 8000), "image/png", 413),
        (bytes((20 << 20) + 1), "image/png", 413),
    ]
    async with server.client() as admin:
        for body, media_type, status in cases:
            reply = await admin.put(
                "/v1/floors/lab-0/plan", content=body, headers={"Content-Type": media_type}
            )
            assert reply.status_code == status, (media_type, len(body))


async def test_a_map_becomes_walls_and_walkable_area(server: ApiServer) -> None:
    path = "/v1/floors/lab-0/map"
    room = polygon((0, 0), (20, 0), (20, 10), (0, 10))
    shop = polygon((0, 0), (8, 0), (8, 4), (0, 4))
    wall = {"type": "LineString", "coordinates": [[8, 0], [8, 4], [0, 4]]}
    document = collection(
        feature("walkable", room),
        feature("obstacle", shop),
        feature("wall", wall, attenuation_db=9),
    )
    async with server.client() as admin:
        assert (await admin.get(path)).status_code == 404
        assert (await admin.put(path, json=document)).status_code == 204
        assert (await admin.get(path)).json() == document
        floor = server.app.state.context.directory.current("lab").floors[0]
        assert [(w.x0_m, w.y1_m, w.attenuation_db) for w in floor.walls] == [(8, 4, 9), (8, 4, 9)]
        assert floor.walkable.distance_at(15, 5) == 0
        assert floor.walkable.distance_at(2, 2) == pytest.approx(2, abs=0.5)
        assert (await admin.delete(path)).status_code == 204
        assert server.app.state.context.directory.current("lab").floors[0].walkable is None


async def test_a_map_that_is_none_is_refused_with_a_pointer(server: ApiServer) -> None:
    room = polygon((0, 0), (20, 0), (20, 10))
    bow_tie = polygon((0, 0), (20, 10), (20, 0), (0, 10))
    cases = [
        ({"type": "Feature"}, "#"),
        (collection(feature("door", room)), "#/features/0/properties/kind"),
        (collection(feature("wall", room)), "#/features/0/geometry/type"),
        (collection(feature("walkable", bow_tie)), "#/features/0/geometry/coordinates"),
        (
            collection(feature("walkable", {"type": "Polygon", "coordinates": [[1, 2]]})),
            "#/features/0/geometry/coordinates",
        ),
        (collection(feature("walkable", room), feature("obstacle", room)), "#/features"),
        (
            collection(
                feature(
                    "wall",
                    {"type": "LineString", "coordinates": [[0, 0], [1, 1]]},
                    attenuation_db=-1,
                )
            ),
            "#/features/0/properties/attenuation_db",
        ),
    ]
    async with server.client() as admin:
        for document, pointer in cases:
            reply = await admin.put("/v1/floors/lab-0/map", json=document)
            assert reply.status_code == 422, pointer
            assert [e["pointer"] for e in reply.json()["errors"]] == [pointer]


async def test_a_device_is_named_and_grows_stale(server: ApiServer) -> None:
    async with server.client() as admin, server.client("phone-7") as phone:
        assert (await admin.get("/v1/devices/phone-7")).status_code == 404
        await phone.post("/v1/ingest", json=batch(ble_record(6, 4, NOW_S * 1000)))
        device = (await admin.get("/v1/devices/phone-7")).json()
        assert (device["status"], device["site_id"], device["person"]) == ("live", "lab", None)
        assert device["last_seen"] == "2026-11-22T02:20:01.000Z"
        patch = {"person": "Ada"}
        named = await admin.patch("/v1/devices/phone-7", json=patch, headers=MERGE)
        assert named.json()["person"] == "Ada"
        server.clock.time_s += 60
        assert (await admin.get("/v1/devices/phone-7")).json()["status"] == "stale"
        server.clock.time_s += 600
        listed = (await admin.get("/v1/devices")).json()["items"]
    assert [(d["device_id"], d["status"]) for d in listed] == [("phone-7", "offline")]


async def test_the_fix_of_a_device_goes_with_its_site(server: ApiServer) -> None:
    async with server.client() as admin, server.client("phone-7") as phone:
        await phone.post("/v1/ingest", json=batch(ble_record(6, 4, NOW_S * 1000)))
        fix = (await admin.get("/v1/devices/phone-7/fix")).json()["fix"]
        assert fix["site_id"] == "lab"
        beacons = (await admin.get("/v1/beacons", params={"site_id": "lab"})).json()["items"]
        paths = [f"/v1/beacons/{beacon['beacon_id']}" for beacon in beacons]
        for path in (*paths, "/v1/floors/lab-0", "/v1/sites/lab"):
            assert (await admin.delete(path)).status_code == 204
        assert (await admin.get("/v1/devices/phone-7/fix")).status_code == 404
        assert (await admin.get("/v1/devices/phone-7")).json()["site_id"] is None


async def test_an_erased_device_leaves_nothing_and_may_come_back(server: ApiServer) -> None:
    async with server.client() as admin, server.client("phone-7") as phone:
        record = ble_record(6, 4, NOW_S * 1000)
        await phone.post("/v1/ingest", json=batch(record))
        assert (await admin.delete("/v1/devices/phone-7")).status_code == 204
        for path in ("", "/fix", "/track"):
            assert (await admin.get(f"/v1/devices/phone-7{path}")).status_code == 404
        assert (await admin.get("/v1/fixes")).json()["items"] == []
        # Its own token went with it.
        assert (await phone.post("/v1/ingest", json=batch(record, seq=1))).status_code == 401
        body = {"name": "n", "role": "device", "site_id": "lab", "device_id": "phone-7"}
        phone.headers["Authorization"] = (
            f"Bearer {(await admin.post('/v1/tokens', json=body)).json()['token']}"
        )
        again = await phone.post("/v1/ingest", json=batch(record, seq=0))
        assert again.json()["duplicate"] is False
        track = (await admin.get("/v1/devices/phone-7/track")).json()["items"]
    assert len(track) <= 1
